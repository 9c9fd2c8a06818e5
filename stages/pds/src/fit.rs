//! Conversion of a label's camera to the pixels of the decoded photo.

use marf_scene::{CameraPrior, Intrinsics};

use crate::{Label, ProductName};

/// Pixel of the detectors of Mastcam and Mastcam-Z, mm.
const MASTCAM_PIXEL_MM: f64 = 7.4e-3;
/// Largest relative deviation of a model's focal length from the lens's.
const FOCAL_TOLERANCE: f64 = 0.05;

impl Label {
    /// Returns the label's camera for the pixels of the decoded photo. `None`, with a note, if it cannot be used.
    pub fn fit_camera(
        &self,
        name: Option<&ProductName>,
        width: u32,
        height: u32,
        notes: &mut Vec<String>,
    ) -> Option<CameraPrior> {
        let mut prior = self.prior.clone()?;
        if notes.iter().any(|note| note.starts_with("turned upright")) {
            notes.push("label has no usable camera: the photo was turned, its camera was not".to_owned());
            return None;
        }
        undo_missing_average(self, name, &mut prior, notes);
        let Some((label_width, label_height)) = self.size else {
            notes.push("label does not give the size its camera is for: taken as the photo's".to_owned());
            return Some(prior);
        };
        if (label_width, label_height) == (width, height) {
            return Some(prior);
        }
        let scale = f64::from(width) / f64::from(label_width);
        let off = (f64::from(label_height) * scale - f64::from(height)).abs();
        if off > 1.0 {
            notes.push(format!(
                "label has no usable camera: it is for {label_width}x{label_height} pixels, the photo has {width}x{height}"
            ));
            return None;
        }
        notes.push(format!(
            "label's camera scaled from {label_width}x{label_height} pixels"
        ));
        prior.model = prior.model.rescaled(scale);
        Some(prior)
    }
}

/// Scales down models that were shifted to their subframe but not reduced like its pixels, as those of MSL thumbnails
/// are. The focal length of the lens shows which.
fn undo_missing_average(
    label: &Label,
    name: Option<&ProductName>,
    prior: &mut CameraPrior,
    notes: &mut Vec<String>,
) {
    let instrument = name.map(|name| name.instrument.as_str()).unwrap_or_default();
    let lens_mm = match instrument {
        "ML" => label.focal_mm.or(Some(34.0)),
        "MR" => label.focal_mm.or(Some(100.0)),
        "ZL" | "ZR" => label.focal_mm,
        _ => None,
    };
    let Some(lens_mm) = lens_mm else { return };
    let Ok(Intrinsics { hs: model_px, .. }) = prior.model.intrinsics() else {
        return;
    };
    let averaged = f64::from(label.averaged.max(1));
    let expected_px = lens_mm / MASTCAM_PIXEL_MM / averaged;
    let fits = |focal_px: f64| (focal_px / expected_px - 1.0).abs() <= FOCAL_TOLERANCE;
    if fits(model_px) {
        return;
    }
    if averaged > 1.0 && fits(model_px / averaged) {
        prior.model = prior.model.rescaled(1.0 / averaged);
        notes.push(format!(
            "label's camera is for whole pixels: reduced by {averaged} like the photo"
        ));
    } else {
        notes.push(format!(
            "label's camera has a focal length of {model_px:.0} px, its lens of {lens_mm} mm {expected_px:.0} px"
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::label::FramePose;

    fn label() -> Label {
        let model = marf_scene::Cahvor {
            c: [0.0; 3],
            a: [1.0, 0.0, 0.0],
            h: [800.0, 4_600.0, 0.0],
            v: [600.0, 0.0, 4_600.0],
            o: None,
            r: None,
            e: None,
        };
        let mut label = Label {
            size: Some((1648, 1200)),
            averaged: 1,
            ..Label::default()
        };
        label.set_place("SITE_FRAME".to_owned(), FramePose::IsSite, vec![1, 2, 3]);
        label.set_camera(&model);
        label
    }

    #[test]
    fn a_photo_that_was_turned_has_no_camera() {
        let mut notes = vec!["turned upright from EXIF orientation 6".to_owned()];
        assert_eq!(label().fit_camera(None, 1648, 1200, &mut notes), None);
        assert!(notes[1].contains("was turned"), "{notes:?}");
    }

    #[test]
    fn a_model_that_is_not_reduced_like_its_pixels_is_found_by_its_lens() {
        let name = ProductName::read("3778ML1037770010808163I01_DXXX").unwrap();
        let with = |averaged, focal_mm| {
            let label = Label {
                averaged,
                focal_mm,
                ..label()
            };
            let mut notes = Vec::new();
            let prior = label.fit_camera(Some(&name), 1648, 1200, &mut notes).unwrap();
            (prior.model.intrinsics().unwrap().hs, notes)
        };
        // 34 mm / 7.4 um = 4595 px.
        assert_eq!(with(1, Some(34.0)), (4_600.0, vec![]));
        assert_eq!(with(8, Some(34.0)).0, 575.0);
        assert_eq!(with(8, None).0, 575.0);
        // A lens of 272 mm reduced by 8 has these very 4595 px: the model is right as it is.
        assert_eq!(with(8, Some(272.0)), (4_600.0, vec![]));
        let (focal, notes) = with(1, Some(100.0));
        assert!(focal == 4_600.0 && notes[0].contains("13514 px"), "{notes:?}");
    }

    #[test]
    fn a_label_without_a_size_says_so() {
        let label = Label {
            size: None,
            ..label()
        };
        let mut notes = Vec::new();
        assert!(label.fit_camera(None, 10, 10, &mut notes).is_some());
        assert!(notes[0].contains("does not give the size"), "{notes:?}");
    }
}
