//! Records that both forms of a COLMAP model share.

use crate::import::distortion::{Distortion, Rational};
use crate::import::lens::{Focal, Lens, MAX_SIDE_PX, unread_lens};

/// An image's record.
pub(super) struct Image {
    pub place: String,
    pub quaternion: [f64; 4],
    pub translation: [f64; 3],
    pub camera: u32,
    pub name: String,
    /// Features found.
    pub features: u32,
    /// Position and number of the point, of those features that have one.
    pub observations: Vec<([f64; 2], u64)>,
}

/// COLMAP's lenses by number, with how many parameters each has.
pub(super) const LENSES: [(&str, usize); 11] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
];
/// Those of them that are not read.
const UNREAD: [&str; 2] = ["FOV", "THIN_PRISM_FISHEYE"];

/// Returns the lens of a COLMAP camera model and its parameters, in the order of `src/colmap/sensor/models.h`.
pub(super) fn lens(name: &str, size: [u64; 2], params: &[f64]) -> Result<Lens, String> {
    let brown = Distortion::Brown;
    let (fx, fy, cx, cy, distortion) = match (name, params) {
        ("SIMPLE_PINHOLE", [f, cx, cy]) => (f, f, cx, cy, brown([0.0; 4])),
        ("PINHOLE", [fx, fy, cx, cy]) => (fx, fy, cx, cy, brown([0.0; 4])),
        ("SIMPLE_RADIAL", [f, cx, cy, k]) => (f, f, cx, cy, brown([*k, 0.0, 0.0, 0.0])),
        ("RADIAL", [f, cx, cy, k1, k2]) => (f, f, cx, cy, brown([*k1, *k2, 0.0, 0.0])),
        ("OPENCV", [fx, fy, cx, cy, k1, k2, p1, p2]) => (fx, fy, cx, cy, brown([*k1, *k2, *p1, *p2])),
        ("FULL_OPENCV", [fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
            let rational = Rational {
                numerator: [*k1, *k2, *k3, 0.0],
                denominator: [*k4, *k5, *k6],
                tangential: [*p1, *p2],
            };
            (fx, fy, cx, cy, rational.simplest())
        }
        ("OPENCV_FISHEYE", [fx, fy, cx, cy, k1, k2, k3, k4]) => {
            (fx, fy, cx, cy, Distortion::Fisheye([*k1, *k2, *k3, *k4]))
        }
        ("SIMPLE_RADIAL_FISHEYE", [f, cx, cy, k]) => (f, f, cx, cy, Distortion::Fisheye([*k, 0.0, 0.0, 0.0])),
        ("RADIAL_FISHEYE", [f, cx, cy, k1, k2]) => (f, f, cx, cy, Distortion::Fisheye([*k1, *k2, 0.0, 0.0])),
        _ => return Err(unread(name, params.len())),
    };
    if let Some(bad) = params.iter().find(|number| !number.is_finite()) {
        return Err(format!("the lens {name} has the parameter {bad}"));
    }
    if *fx <= 0.0 || *fy <= 0.0 {
        return Err(format!("{fx} and {fy} are not focal lengths in pixels"));
    }
    let side = |side: u64| {
        u32::try_from(side)
            .ok()
            .filter(|side| (1..=MAX_SIDE_PX).contains(side))
    };
    let size = side(size[0]).zip(side(size[1]));
    Ok(Lens {
        size: Some(size.ok_or_else(|| format!("a size beyond 1 to {MAX_SIDE_PX} pixels a side"))?),
        focal: Focal::Px(*fx, *fy),
        cx_px: Some(*cx),
        cy_px: Some(*cy),
        distortion,
    })
}

/// Returns why a camera model is not read.
fn unread(name: &str, given: usize) -> String {
    let is_read = |lens: &&(&str, usize)| !UNREAD.contains(&lens.0);
    let mut read = LENSES.iter().filter(is_read);
    match read.clone().find(|lens| lens.0 == name) {
        Some((_, needed)) => format!("the lens {name} has {needed} parameters, {given} are given"),
        None => unread_lens(name, &read.by_ref().map(|lens| lens.0).collect::<Vec<_>>()),
    }
}
