//! From the files of a shard to rows and verdicts.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

use marf_cache::manifest::Row;
use marf_scene::{CameraPrior, Photo, PhotoFacts};
use marf_stage::{Ctx, Fetched, StageError, Verdict};
use rayon::prelude::*;

use crate::archive::{ArchiveFile, Kind};
use crate::camera::{focal_px, rescaled};
use crate::exif::{self, Lens};
use crate::label::Label;
use crate::names::ProductName;
use crate::products::{Product, Sorted, left, sort};
use crate::raw;

/// Pixel of the detectors of Mastcam and Mastcam-Z, mm.
const MASTCAM_PIXEL_MM: f64 = 7.4e-3;
/// Largest deviation of a model's focal length from the lens's.
const FOCAL_TOLERANCE: f64 = 0.05;

/// Brings one shard.
///
/// # Errors
/// The store, the wish to stop, or a file that changed; a bad file is a verdict.
pub(crate) fn fetch(ctx: &Ctx<'_>, files: &[ArchiveFile], shard: u32) -> Result<Fetched, StageError> {
    let Sorted { products, left_out } = sort(ctx, files)?;
    let (done, total) = (AtomicU64::new(0), products.len() as u64);
    let outcomes: Result<Vec<_>, StageError> = products
        .par_iter()
        .map(|product| {
            ctx.check()?;
            let outcome = one_product(ctx, product, shard)?;
            ctx.progress
                .at(done.fetch_add(1, Ordering::Relaxed) + 1, total, "");
            Ok(outcome)
        })
        .collect();
    let mut fetched = Fetched {
        rows: Vec::new(),
        verdicts: left_out,
    };
    for (row, verdicts) in outcomes? {
        fetched.rows.extend(row);
        fetched.verdicts.extend(verdicts);
    }
    fetched.verdicts.sort_by(|a, b| a.file.cmp(&b.file));
    Ok(fetched)
}

/// Takes the first file of a product that can be decoded; the others get a verdict each.
fn one_product(
    ctx: &Ctx<'_>,
    product: &Product,
    shard: u32,
) -> Result<(Option<Row>, Vec<Verdict>), StageError> {
    let mut verdicts = Vec::new();
    let mut row: Option<Row> = None;
    for file in &product.files {
        if let Some(row) = &row {
            let reason = format!(
                "another file of product {}, of which a better one is taken",
                row.id
            );
            verdicts.push(left(&file.name, "skipped", reason));
            continue;
        }
        let bytes = file.read(ctx)?;
        match decode(product, file, &bytes) {
            Ok(decoded) => {
                verdicts.push(Verdict {
                    id: product.id.clone(),
                    ..left(&file.name, Verdict::KEEP, String::new())
                });
                row = Some(make_row(ctx, product, file, &bytes, decoded, shard)?);
            }
            Err(reason) => verdicts.push(left(&file.name, "decode", reason)),
        }
    }
    Ok((row, verdicts))
}

/// A decoded photo, and what its own file said.
struct Decoded {
    size: (u32, u32),
    bands: u8,
    notes: Vec<String>,
    lens: Lens,
    /// The picture later stages decode, if not the file itself.
    made: Option<Vec<u8>>,
    /// The label at the head of the file.
    attached: Option<Label>,
}

fn decode(product: &Product, file: &ArchiveFile, bytes: &[u8]) -> Result<Decoded, String> {
    let (name, beside) = (
        product.name.as_ref(),
        product.label.as_ref().map(|label| &label.label),
    );
    if file.kind == Kind::Raw {
        let developed = raw::develop(name, bytes, beside)?;
        return Ok(Decoded {
            size: (developed.made.image.width, developed.made.image.height),
            bands: developed.made.bands,
            notes: developed.made.notes,
            lens: Lens::default(),
            made: Some(raw::png(&developed.made.image)?),
            attached: developed.attached,
        });
    }
    let photo = Photo::decode(bytes).map_err(|error| error.to_string())?;
    let mosaic = name.is_some_and(ProductName::says_mosaic);
    let phase = beside.and_then(|label| label.mosaic.or(label.phase));
    let developed = if mosaic {
        raw::develop_mosaic(&photo, phase)
    } else {
        None
    };
    let made = developed
        .as_ref()
        .map(|photo| raw::png(&photo.image))
        .transpose()?;
    let photo = developed.unwrap_or(photo);
    // A mosaic is half as large when developed, and no archive writes EXIF into one.
    let lens = match made {
        None => exif::read(bytes, photo.image.width.max(photo.image.height)),
        Some(_) => Lens::default(),
    };
    Ok(Decoded {
        size: (photo.image.width, photo.image.height),
        bands: photo.bands,
        notes: photo.notes,
        lens,
        made,
        attached: None,
    })
}

fn make_row(
    ctx: &Ctx<'_>,
    product: &Product,
    file: &ArchiveFile,
    bytes: &[u8],
    decoded: Decoded,
    shard: u32,
) -> Result<Row, StageError> {
    let mut blobs = BTreeMap::new();
    let stored = ctx.put(bytes)?;
    match &decoded.made {
        Some(made) => {
            blobs.insert("image".to_owned(), ctx.put(made)?);
            blobs.insert("raw".to_owned(), stored);
        }
        None => {
            blobs.insert("image".to_owned(), stored);
        }
    }
    if let Some(label) = &product.label {
        blobs.insert("label".to_owned(), label.digest);
    }
    Ok(Row {
        id: product.id.clone(),
        blobs,
        facts: facts(product, file, bytes.len(), decoded, shard).to_json(),
    })
}

fn facts(
    product: &Product,
    file: &ArchiveFile,
    size_bytes: usize,
    decoded: Decoded,
    shard: u32,
) -> PhotoFacts {
    let mut notes = decoded.notes;
    notes.extend(decoded.lens.notes);
    let name = product.name.as_ref();
    let detached = product.label.as_ref().map(|label| &label.label);
    let attached = decoded.attached.as_ref();
    // The label in the file is of this very file; a label beside it may be of another rendition.
    let first =
        |get: &dyn Fn(&Label) -> Option<String>| attached.and_then(get).or_else(|| detached.and_then(get));
    let with_camera = [attached, detached]
        .into_iter()
        .flatten()
        .find(|label| label.prior.is_some());
    let prior = with_camera.and_then(|label| fit_camera(label, name, decoded.size, &mut notes));
    if let Some(label) = with_camera.or(attached).or(detached) {
        notes.extend(label.notes.iter().cloned());
    }
    let sol = [attached, detached]
        .into_iter()
        .flatten()
        .find_map(|label| label.sol);
    let sol = name.and_then(|name| name.sol).or(sol);
    if let Some(other) = sol.filter(|sol| *sol != shard) {
        notes.push(format!("label says sol {other}"));
    }
    PhotoFacts {
        file: file.name.clone(),
        size_bytes: size_bytes as u64,
        width: decoded.size.0,
        height: decoded.size.1,
        bands: decoded.bands,
        sol,
        instrument: name
            .map(|name| name.instrument.clone())
            .or_else(|| first(&|label| label.instrument.clone())),
        filter: name
            .and_then(|name| name.filter.clone())
            .or_else(|| first(&|label| label.filter.clone())),
        thumbnail: name.is_some_and(|name| name.thumbnail)
            || [attached, detached]
                .into_iter()
                .flatten()
                .any(|label| label.thumbnail),
        prior,
        focal_px: decoded.lens.focal_px,
        device: decoded.lens.device,
        notes,
    }
}

/// Carries a label's camera into the photo's pixel grid, or says why it cannot be used.
fn fit_camera(
    label: &Label,
    name: Option<&ProductName>,
    (width, height): (u32, u32),
    notes: &mut Vec<String>,
) -> Option<CameraPrior> {
    let mut prior = label.prior.clone()?;
    if notes.iter().any(|note| note.starts_with("turned upright")) {
        notes.push("label has no usable camera: the photo was turned, its camera was not".to_owned());
        return None;
    }
    undo_missing_average(label, name, &mut prior, notes);
    let Some((label_width, label_height)) = label.size else {
        notes.push("label does not tell the size its camera is for; taken as the photo's".to_owned());
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
    prior.model = rescaled(&prior.model, scale);
    Some(prior)
}

/// Models of MSL thumbnails are shifted to their subframe but not reduced like their pixels: the lens tells.
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
    let (model_px, _) = focal_px(&prior.model);
    let averaged = f64::from(label.averaged.max(1));
    let expected_px = lens_mm / MASTCAM_PIXEL_MM / averaged;
    let fits = |focal_px: f64| (focal_px / expected_px - 1.0).abs() <= FOCAL_TOLERANCE;
    if fits(model_px) {
        return;
    }
    if averaged > 1.0 && fits(model_px / averaged) {
        prior.model = rescaled(&prior.model, 1.0 / averaged);
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
        let raw = crate::camera::RawModel {
            cahv: [
                [0.0; 3],
                [1.0, 0.0, 0.0],
                [800.0, 4_600.0, 0.0],
                [600.0, 0.0, 4_600.0],
            ],
            ..Default::default()
        };
        let mut label = Label {
            size: Some((1648, 1200)),
            averaged: 1,
            ..Label::default()
        };
        label.set_camera(&raw, "SITE_FRAME".to_owned(), FramePose::IsSite, vec![1, 2, 3]);
        label
    }

    #[test]
    fn a_photo_that_was_turned_has_no_camera() {
        let mut notes = vec!["turned upright from EXIF orientation 6".to_owned()];
        assert_eq!(fit_camera(&label(), None, (1648, 1200), &mut notes), None);
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
            let prior = fit_camera(&label, Some(&name), (1648, 1200), &mut notes).unwrap();
            (focal_px(&prior.model).0, notes)
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
        assert!(fit_camera(&label, None, (10, 10), &mut notes).is_some());
        assert!(notes[0].contains("does not tell the size"), "{notes:?}");
    }
}
