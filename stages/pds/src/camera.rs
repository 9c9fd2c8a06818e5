//! Checks and normalisation of the camera models of labels.

use marf_scene::{Cahvor, CahvorError, EntrancePupil};

/// Largest tolerated deviation of |A| and |O| from 1: labels of six digits leave 8e-6.
const UNIT_TOLERANCE: f64 = 1e-3;
/// Largest ratio of the two focal lengths: detectors average up to 8 pixels along one side alone.
const MAX_ASPECT: f64 = 8.0;

/// A camera model as a label writes it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct RawModel {
    /// C, A, H, V.
    pub cahv: [[f64; 3]; 4],
    /// O and R.
    pub distortion: Option<[[f64; 3]; 2]>,
    /// The entrance pupil of a CAHVORE.
    pub entrance: Option<RawEntrance>,
}

/// The entrance pupil of a CAHVORE as a label writes it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawEntrance {
    /// E.
    pub terms: [f64; 3],
    /// The model's type, 1, 2 or 3.
    pub kind: i64,
    /// Its parameter.
    pub parameter: f64,
}

/// A camera model that cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// A number that is missing, not finite or a sentinel.
    #[error("{0} is missing or no finite number")]
    Number(&'static str),
    /// A vector that should be of length 1.
    #[error("|{name}| is {length:.6}, not 1 within {UNIT_TOLERANCE}")]
    NotUnit {
        /// Letter of the vector.
        name: char,
        /// Its length.
        length: f64,
    },
    /// Focal lengths below one pixel, or too far apart for one camera.
    #[error(
        "focal lengths |A x H| = {horizontal_px:.3} px and |A x V| = {vertical_px:.3} px are not those of one camera"
    )]
    Focal {
        /// |A x H|.
        horizontal_px: f64,
        /// |A x V|.
        vertical_px: f64,
    },
    /// Axes that are (nearly) parallel or mirrored.
    #[error("A . (H x V) is {0:.3e} of the product of the focal lengths: axes are parallel or mirrored")]
    Axes(f64),
    /// A type of CAHVORE that does not exist.
    #[error("CAHVORE type {0} is not 1, 2 or 3")]
    EntranceType(i64),
    /// A lens whose projection fails or turns over within the photo.
    #[error(transparent)]
    Lens(CahvorError),
}

/// Returns the model with A, H and V divided by |A| together, and O by |O|.
///
/// Six-digit labels leave |A| - 1 of about 8e-6. Dividing A alone would move pixels by 0.01. The result is exact to
/// rounding of f64.
///
/// # Errors
/// See [`CameraError`].
pub fn normalised(raw: &RawModel) -> Result<Cahvor, CameraError> {
    check_finite(raw)?;
    let [c, a, h, v] = raw.cahv;
    let length = unit_length('A', a)?;
    let [a, h, v] = [a, h, v].map(|vector| vector.map(|value| value / length));
    check_axes(a, h, v)?;
    let o = match raw.distortion {
        Some([o, _]) => {
            let length = unit_length('O', o)?;
            Some(o.map(|value| value / length))
        }
        None => None,
    };
    Ok(Cahvor {
        c,
        a,
        h,
        v,
        o,
        r: raw.distortion.map(|[_, r]| r),
        e: raw.entrance.map(entrance).transpose()?,
    })
}

/// Returns h_s = |A x H| and v_s = |A x V|: the focal lengths in pixels of a normalised model.
pub fn focal_px(model: &Cahvor) -> (f64, f64) {
    (norm(cross(model.a, model.h)), norm(cross(model.a, model.v)))
}

/// Returns the model for a photo scaled by `scale`. Integer coordinates stay pixel centres.
///
/// The pixel corner x + 0.5 scales, hence x' = s (x + 0.5) - 0.5, and H' = s H + (s - 1)/2 A.
pub fn rescaled(model: &Cahvor, scale: f64) -> Cahvor {
    let shift = (scale - 1.0) / 2.0;
    let carry = |rows: [f64; 3]| [0, 1, 2].map(|axis| scale * rows[axis] + shift * model.a[axis]);
    Cahvor {
        h: carry(model.h),
        v: carry(model.v),
        ..*model
    }
}

pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub fn norm(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

fn check_finite(raw: &RawModel) -> Result<(), CameraError> {
    let usable = |vector: &[f64; 3]| vector.iter().all(|value| value.is_finite() && value.abs() < 1e29);
    let names = ["C", "A", "H", "V"];
    let bad = names
        .into_iter()
        .zip(&raw.cahv)
        .find(|(_, vector)| !usable(vector));
    if let Some((name, _)) = bad {
        return Err(CameraError::Number(name));
    }
    match raw.distortion {
        Some([o, _]) if !usable(&o) => return Err(CameraError::Number("O")),
        Some([_, r]) if !usable(&r) => return Err(CameraError::Number("R")),
        _ => {}
    }
    match raw.entrance {
        Some(pupil) if !usable(&pupil.terms) || !usable(&[pupil.parameter; 3]) => {
            Err(CameraError::Number("E"))
        }
        _ => Ok(()),
    }
}

fn unit_length(name: char, vector: [f64; 3]) -> Result<f64, CameraError> {
    let length = norm(vector);
    if (length - 1.0).abs() <= UNIT_TOLERANCE {
        Ok(length)
    } else {
        Err(CameraError::NotUnit { name, length })
    }
}

fn check_axes(a: [f64; 3], h: [f64; 3], v: [f64; 3]) -> Result<(), CameraError> {
    let (horizontal_px, vertical_px) = (norm(cross(a, h)), norm(cross(a, v)));
    let (less, more) = (horizontal_px.min(vertical_px), horizontal_px.max(vertical_px));
    if !(less >= 1.0 && more <= MAX_ASPECT * less) {
        return Err(CameraError::Focal {
            horizontal_px,
            vertical_px,
        });
    }
    let share = dot(a, cross(h, v)) / (horizontal_px * vertical_px);
    if share > 0.5 {
        Ok(())
    } else {
        Err(CameraError::Axes(share))
    }
}

fn entrance(pupil: RawEntrance) -> Result<EntrancePupil, CameraError> {
    let linearity = match pupil.kind {
        1 => 1.0,
        2 => 0.0,
        3 => pupil.parameter,
        other => return Err(CameraError::EntranceType(other)),
    };
    Ok(EntrancePupil {
        terms: pupil.terms,
        linearity,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raw() -> RawModel {
        RawModel {
            cahv: [
                [0.8, 0.56, -1.92],
                [1.0 + 8e-6, 0.0, 0.0],
                [823.5, 14_800.0, 0.0],
                [599.5, 0.0, 14_800.0],
            ],
            distortion: Some([[0.999_9, 0.009_999, 0.009_999], [0.0002, 0.39, 0.035]]),
            entrance: None,
        }
    }

    #[test]
    fn a_h_and_v_are_divided_together() {
        let model = normalised(&raw()).unwrap();
        assert!((norm(model.a) - 1.0).abs() < 1e-15 && (norm(model.o.unwrap()) - 1.0).abs() < 1e-15);
        // The pixel of a point, (p.H)/(p.A), must not move.
        let p = [5.0, 0.3, -0.2];
        let before = dot(p, raw().cahv[2]) / dot(p, raw().cahv[1]);
        assert!((dot(p, model.h) / dot(p, model.a) - before).abs() < 1e-9);
        assert!((focal_px(&model).0 - 14_800.0 / (1.0 + 8e-6)).abs() < 1e-9);
    }

    #[test]
    fn unusable_models_are_refused_by_name() {
        let check = |change: &dyn Fn(&mut RawModel), part: &str| {
            let mut bad = raw();
            change(&mut bad);
            let error = normalised(&bad).unwrap_err().to_string();
            assert!(error.contains(part), "{part}: {error}");
        };
        check(&|raw| raw.cahv[0][1] = f64::NAN, "C is missing");
        check(&|raw| raw.cahv[2][0] = 1e30, "H is missing");
        check(&|raw| raw.cahv[1][0] = 1.002, "|A| is 1.002000");
        check(
            &|raw| raw.distortion = Some([[0.9, 0.0, 0.0], [0.0; 3]]),
            "|O| is 0.9",
        );
        check(&|raw| raw.cahv[3] = raw.cahv[2], "parallel");
        check(&|raw| raw.cahv[2] = [0.0; 3], "focal lengths");
        check(&|raw| raw.cahv[3][2] = 130_000.0, "not those of one camera");
        check(&|raw| raw.cahv.swap(2, 3), "mirrored");
        let pupil = |term: f64, kind: i64| RawEntrance {
            terms: [term; 3],
            kind,
            parameter: 0.0,
        };
        check(&|raw| raw.entrance = Some(pupil(0.0, 4)), "type 4");
        check(
            &|raw| raw.entrance = Some(pupil(f64::INFINITY, 2)),
            "E is missing",
        );
    }

    /// A camera whose lines were averaged in pairs, and one of a linearised product.
    #[test]
    fn unequal_focal_lengths_are_those_of_a_camera() {
        for vertical_px in [7_400.0, 15_900.0, 29_600.0] {
            let mut unequal = raw();
            unequal.cahv[3][2] = vertical_px;
            let model = normalised(&unequal).unwrap();
            let scale = 1.0 + 8e-6;
            let expected = (14_800.0 / scale, vertical_px / scale);
            let found = focal_px(&model);
            assert!(
                (found.0 - expected.0).abs() < 1e-9 && (found.1 - expected.1).abs() < 1e-9,
                "{found:?}"
            );
        }
    }

    #[test]
    fn the_type_of_a_cahvore_decides_its_linearity() {
        for (kind, parameter, linearity) in [(1, 0.3, 1.0), (2, 0.3, 0.0), (3, 0.6, 0.6)] {
            let mut model = raw();
            model.entrance = Some(RawEntrance {
                terms: [0.0; 3],
                kind,
                parameter,
            });
            assert_eq!(
                normalised(&model).unwrap().e.unwrap().linearity,
                linearity,
                "type {kind}"
            );
        }
    }

    #[test]
    fn a_model_binned_by_eight_sees_the_same_point_at_the_binned_pixel() {
        let model = normalised(&raw()).unwrap();
        let binned = rescaled(&model, 1.0 / 8.0);
        let p = [5.0, 0.3, -0.2];
        let (before, after) = (
            dot(p, model.h) / dot(p, model.a),
            dot(p, binned.h) / dot(p, binned.a),
        );
        assert!((after - (before - 3.5) / 8.0).abs() < 1e-9, "{before} {after}");
    }
}
