//! The lens of a frame of transforms.json.

use crate::import::cameras::ImportError;
use crate::import::distortion::{Distortion, Rational};
use crate::import::json_node::JsonNode;
use crate::import::lens::{Focal, Lens, MAX_SIDE_PX, unread_lens};

/// Models of radial and tangential terms.
const PERSPECTIVE: [&str; 7] = [
    "OPENCV",
    "FULL_OPENCV",
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "PERSPECTIVE",
];
/// Models of terms of the angle off the axis.
const FISHEYE: [&str; 4] = [
    "OPENCV_FISHEYE",
    "FISHEYE",
    "RADIAL_FISHEYE",
    "SIMPLE_RADIAL_FISHEYE",
];

/// Returns the frame's own intrinsics, each else that at the top.
pub(super) fn lens(root: &JsonNode<'_>, frame: &JsonNode<'_>) -> Result<Lens, ImportError> {
    let find = |key: &str| frame.get(key).or_else(|| root.get(key));
    let number = |key: &str| find(key).map(|node| node.number()).transpose();
    let size = match (find("w"), find("h")) {
        (Some(w), Some(h)) => Some((side(&w)?, side(&h)?)),
        (None, None) => None,
        (Some(one), None) | (None, Some(one)) => return Err(one.error("`w` and `h` belong together")),
    };
    Ok(Lens {
        size,
        focal: focal(frame, &find)?,
        cx_px: number("cx")?,
        cy_px: number("cy")?,
        distortion: distortion(&find)?,
    })
}

/// Returns how the lens bends the picture.
///
/// k4 of a lens that is neither a fisheye nor `FULL_OPENCV`, and has no k5 and k6, is nerfstudio's: a factor of r⁸.
fn distortion<'a>(find: &impl Fn(&str) -> Option<JsonNode<'a>>) -> Result<Distortion, ImportError> {
    let term =
        |key: &str| Ok::<f64, ImportError>(find(key).map(|node| node.number()).transpose()?.unwrap_or(0.0));
    let [k1, k2, k3, k4] = [term("k1")?, term("k2")?, term("k3")?, term("k4")?];
    let [k5, k6] = [term("k5")?, term("k6")?];
    let model = find("camera_model");
    let name = model
        .as_ref()
        .map(|node| node.text())
        .transpose()?
        .map(str::to_ascii_uppercase);
    let name = name.as_deref().unwrap_or("OPENCV");
    let is_fisheye = find("is_fisheye")
        .map(|node| node.truth())
        .transpose()?
        .unwrap_or(false);
    if is_fisheye || FISHEYE.contains(&name) {
        return Ok(Distortion::Fisheye([k1, k2, k3, k4]));
    }
    if let Some(model) = model.filter(|_| !PERSPECTIVE.contains(&name)) {
        return Err(model.error(unread_lens(
            model.text()?,
            &[&PERSPECTIVE[..], &FISHEYE[..]].concat(),
        )));
    }
    let is_fraction = name == "FULL_OPENCV" || [k5, k6] != [0.0; 2];
    let (fourth, denominator) = if is_fraction {
        (0.0, [k4, k5, k6])
    } else {
        (k4, [0.0; 3])
    };
    let rational = Rational {
        numerator: [k1, k2, k3, fourth],
        denominator,
        tangential: [term("p1")?, term("p2")?],
    };
    Ok(rational.simplest())
}

/// A whole number of pixels. Some files write `1440.0`.
fn side(node: &JsonNode<'_>) -> Result<u32, ImportError> {
    let number = node.number()?;
    let whole = number >= 1.0 && number <= f64::from(MAX_SIDE_PX) && number.fract() == 0.0;
    let refuse = || {
        node.error(format!(
            "{number} is not a size in whole pixels from 1 to {MAX_SIDE_PX}"
        ))
    };
    whole.then_some(number as u32).ok_or_else(refuse)
}

/// Returns the focal length of a frame. The frame's angle takes precedence over a focal length at the top.
fn focal<'a>(
    frame: &JsonNode<'a>,
    find: &impl Fn(&str) -> Option<JsonNode<'a>>,
) -> Result<Focal, ImportError> {
    let has = |key: &str| frame.get(key).is_some();
    let has_own_angle = has("camera_angle_x") && !has("fl_x") && !has("fl_y");
    let length = |key: &str| {
        let node = find(key).filter(|_| !has_own_angle);
        positive(node, f64::MAX, "a positive focal length in pixels")
    };
    let angle = |key: &str| {
        let what = "an angle of view in radians between 0 and π";
        positive(find(key), std::f64::consts::PI, what)
    };
    match (length("fl_x")?, length("fl_y")?) {
        (Some(x), y) => Ok(Focal::Px(x, y.unwrap_or(x))),
        (None, Some(y)) => Ok(Focal::Px(y, y)),
        (None, None) => match (angle("camera_angle_x")?, angle("camera_angle_y")?) {
            (Some(x), y) => Ok(Focal::Angle(x, y)),
            (None, _) => Err(frame.error("neither `fl_x` nor `camera_angle_x`, here or at the top")),
        },
    }
}

/// Returns a number in (0, below), if there is one.
fn positive(node: Option<JsonNode<'_>>, below: f64, what: &str) -> Result<Option<f64>, ImportError> {
    let Some(node) = node else {
        return Ok(None);
    };
    let number = node.number()?;
    let good = number > 0.0 && number < below;
    good.then_some(Some(number))
        .ok_or_else(|| node.error(format!("{number} is not {what}")))
}
