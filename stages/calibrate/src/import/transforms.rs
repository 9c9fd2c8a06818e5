//! transforms.json of instant-ngp and nerfstudio, and the split sets of the NeRF paper.

use std::collections::BTreeSet;

use marf_scene::Pose;
use nalgebra::{Matrix3, Vector3};
use serde_json::Value;

use super::cameras::{ImportError, Role, View};
use super::choose::folder;
use super::json_node::JsonNode;
use super::lens::{Focal, Lens, MAX_SIDE_PX};

/// Models that k1, k2, p1, p2 cover; anything else needs equations we do not have.
const LENSES: [&str; 6] = [
    "OPENCV",
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "PERSPECTIVE",
];
/// Names the file of the sparse points; nerfstudio's key.
pub(super) const POINTS_KEY: &str = "ply_file_path";
/// A rotation may be this far from orthonormal: files with six digits are 1e-6 off, a shear is not.
const ROTATION_TOLERANCE: f64 = 1e-3;
/// Rotations closer than this to orthonormal are taken as they are.
const ROTATION_EXACT: f64 = 1e-14;

/// Content of a transforms.json.
#[derive(Debug, Clone, PartialEq)]
pub struct Transforms {
    /// One for each frame.
    pub views: Vec<View>,
    /// The PLY with the sparse points of the same world, relative to the archive, if one is named.
    pub points: Option<String>,
}

/// Reads the cameras of a transforms.json.
///
/// Camera to world with x right, y up, z backward (OpenGL) becomes world to camera with x right, y down,
/// z forward. Intrinsics stand at the top or with a frame, the frame's count; without `fl_x` the focal length
/// comes from `camera_angle_x`; without `w` and `h` they are for the photo's size; missing lens terms are 0.
/// `train_filenames`, `val_filenames` and `test_filenames` decide what is measured; a photo in several of them
/// is measured. A uniform scale of the rotation is divided out. `file` names the JSON relative to the archive;
/// the names in it are relative to its folder. Of the sparse points the file's name, `ply_file_path`, is read.
///
/// # Errors
/// Names the place in the file: not JSON (NaN and infinities are not), nesting deeper than 128, a missing or
/// non-finite number, a focal length or size that is not positive, a matrix that is not 4 x 4, singular,
/// mirrored or sheared, a path that is absolute or leaves the archive, a lens we have no equations for.
pub fn read_transforms(file: &str, bytes: &[u8]) -> Result<Transforms, ImportError> {
    let value: Value = serde_json::from_slice(bytes).map_err(|error| {
        ImportError::new(
            file,
            "",
            format!("not JSON: {error} (NaN and infinities are no JSON numbers)"),
        )
    })?;
    let root = JsonNode::root(file, &value);
    if !value.is_object() {
        return Err(root.error("not an object with `frames`"));
    }
    let roles = Roles::read(&root)?;
    let frames = root.required("frames")?.items()?;
    if frames.is_empty() {
        return Err(root.error("`frames` is empty"));
    }
    let views = frames.iter().map(|frame| view(&root, frame, &roles));
    let points = root.get(POINTS_KEY).map(|node| path(&node));
    Ok(Transforms {
        views: views.collect::<Result<_, _>>()?,
        points: points.transpose()?,
    })
}

/// Returns the view of a frame.
fn view(root: &JsonNode<'_>, frame: &JsonNode<'_>, roles: &Roles) -> Result<View, ImportError> {
    let name = path(&frame.required("file_path")?)?;
    Ok(View {
        place: frame.pointer.clone(),
        role: roles.role(&name),
        file: name,
        lens: lens(root, frame)?,
        cam_from_world: pose(&frame.required("transform_matrix")?)?,
        matches: None,
        inliers: None,
        error_px: None,
    })
}

/// A path as the archive has it: relative to its root, with `/`.
fn path(node: &JsonNode<'_>) -> Result<String, ImportError> {
    let text = node.text()?.replace('\\', "/");
    let drive = text.as_bytes().get(1) == Some(&b':');
    if text.starts_with('/') || drive {
        return Err(node.error(format!("`{text}` is absolute; names are relative to this file")));
    }
    let joined = format!("{}{text}", folder(node.file));
    let mut parts: Vec<&str> = Vec::new();
    for part in joined.split('/') {
        match part {
            "" | "." => {}
            ".." => {
                let outside = || node.error(format!("`{text}` leads out of the archive"));
                parts.pop().ok_or_else(outside)?;
            }
            part => parts.push(part),
        }
    }
    if parts.is_empty() {
        return Err(node.error("an empty name"));
    }
    Ok(parts.join("/"))
}

/// Names by what they are for.
struct Roles {
    train: Option<BTreeSet<String>>,
    held_out: Option<BTreeSet<String>>,
}

impl Roles {
    fn read(root: &JsonNode<'_>) -> Result<Self, ImportError> {
        let list = |key: &str| -> Result<Option<BTreeSet<String>>, ImportError> {
            let Some(node) = root.get(key) else {
                return Ok(None);
            };
            let names: Result<BTreeSet<String>, ImportError> = node.items()?.iter().map(path).collect();
            Ok(Some(names?).filter(|names| !names.is_empty()))
        };
        let (val, test) = (list("val_filenames")?, list("test_filenames")?);
        let held_out = match (val, test) {
            (Some(val), Some(test)) => Some(val.into_iter().chain(test).collect()),
            (val, test) => val.or(test),
        };
        let train = list("train_filenames")?;
        Ok(Self { train, held_out })
    }

    /// Returns the purpose of a photo.
    fn role(&self, name: &str) -> Role {
        let within = |names: &Option<BTreeSet<String>>| names.as_ref().map(|names| names.contains(name));
        match (within(&self.train), within(&self.held_out)) {
            (None, None) => Role::Open,
            (_, Some(true)) | (Some(false), None) => Role::HeldOut,
            (Some(true), _) | (None, Some(false)) => Role::Train,
            (Some(false), Some(false)) => Role::Unlisted,
        }
    }
}

/// The frame's own intrinsics, else those at the top.
fn lens(root: &JsonNode<'_>, frame: &JsonNode<'_>) -> Result<Lens, ImportError> {
    let find = |key: &str| frame.get(key).or_else(|| root.get(key));
    let number = |key: &str| find(key).map(|node| node.number()).transpose();
    check_model(&find)?;
    let size = match (find("w"), find("h")) {
        (Some(w), Some(h)) => Some((side(&w)?, side(&h)?)),
        (None, None) => None,
        (Some(one), None) | (None, Some(one)) => return Err(one.error("`w` and `h` belong together")),
    };
    let term = |key: &str| Ok::<f64, ImportError>(number(key)?.unwrap_or(0.0));
    Ok(Lens {
        size,
        focal: focal(frame, &find)?,
        cx_px: number("cx")?,
        cy_px: number("cy")?,
        distortion: [term("k1")?, term("k2")?, term("p1")?, term("p2")?],
    })
}

/// Refuses lenses that k1, k2, p1 and p2 do not cover.
fn check_model<'a>(find: &impl Fn(&str) -> Option<JsonNode<'a>>) -> Result<(), ImportError> {
    if let Some(model) = find("camera_model")
        && !LENSES.contains(&model.text()?.to_ascii_uppercase().as_str())
    {
        let known = LENSES.join(", ");
        return Err(model.error(format!(
            "the lens `{}` is not read; these are: {known}",
            model.text()?
        )));
    }
    if let Some(fisheye) = find("is_fisheye")
        && fisheye.truth()?
    {
        return Err(fisheye.error("fish-eye lenses are not read"));
    }
    for key in ["k3", "k4", "k5", "k6"] {
        if let Some(term) = find(key)
            && term.number()? != 0.0
        {
            return Err(term.error("only k1, k2, p1 and p2 are read, this term is not 0"));
        }
    }
    Ok(())
}

/// A whole number of pixels; some files write `1440.0`.
fn side(node: &JsonNode<'_>) -> Result<u32, ImportError> {
    let number = node.number()?;
    let whole = number >= 1.0 && number <= f64::from(MAX_SIDE_PX) && number.fract() == 0.0;
    let refuse = || {
        node.error(format!(
            "{number} is no size in whole pixels from 1 to {MAX_SIDE_PX}"
        ))
    };
    whole.then_some(number as u32).ok_or_else(refuse)
}

/// Returns the focal length of a frame.
fn focal<'a>(
    frame: &JsonNode<'a>,
    find: &impl Fn(&str) -> Option<JsonNode<'a>>,
) -> Result<Focal, ImportError> {
    let positive = |key: &str| positive(find(key), f64::MAX, "a positive focal length in pixels");
    let angle = |key: &str| positive_angle(find(key));
    match (positive("fl_x")?, positive("fl_y")?) {
        (Some(x), y) => Ok(Focal::Px(x, y.unwrap_or(x))),
        (None, Some(y)) => Ok(Focal::Px(y, y)),
        (None, None) => match (angle("camera_angle_x")?, angle("camera_angle_y")?) {
            (Some(x), y) => Ok(Focal::Angle(x, y)),
            (None, _) => Err(frame.error("neither `fl_x` nor `camera_angle_x`, here or at the top")),
        },
    }
}

fn positive_angle(node: Option<JsonNode<'_>>) -> Result<Option<f64>, ImportError> {
    positive(
        node,
        std::f64::consts::PI,
        "an angle of view in radians between 0 and π",
    )
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

/// Returns the pose of a transform matrix.
fn pose(node: &JsonNode<'_>) -> Result<Pose, ImportError> {
    let rows = node.items()?;
    if rows.len() != 4 {
        return Err(node.error(format!("{} rows, a transform has 4 of 4 numbers", rows.len())));
    }
    let mut matrix = [[0.0; 4]; 4];
    for (row, numbers) in matrix.iter_mut().zip(&rows) {
        let values = numbers.items()?;
        if values.len() != 4 {
            return Err(numbers.error(format!("{} numbers, a row of a transform has 4", values.len())));
        }
        for (number, value) in row.iter_mut().zip(&values) {
            *number = value.number()?;
        }
    }
    let last = [0.0, 0.0, 0.0, 1.0];
    if matrix[3]
        .iter()
        .zip(last)
        .any(|(ours, rigid)| (ours - rigid).abs() > 1e-6)
    {
        return Err(node.error(format!(
            "the last row is {:?}, a rigid transform has 0, 0, 0, 1",
            matrix[3]
        )));
    }
    let world_from_gl = Matrix3::from_fn(|row, column| matrix[row][column]);
    let centre = Vector3::from_fn(|row, _| matrix[row][3]);
    let rotation = rotation(&world_from_gl).map_err(|problem| node.error(problem))?;
    let cam_from_gl = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    let cam_from_world = cam_from_gl * rotation.transpose();
    Ok(Pose {
        rotation: cam_from_world,
        translation: -(cam_from_world * centre),
    })
}

/// Divides out a uniform scale and makes rounded digits orthonormal again.
fn rotation(matrix: &Matrix3<f64>) -> Result<Matrix3<f64>, String> {
    let determinant = matrix.determinant();
    if !determinant.is_normal() || determinant < 0.0 {
        return Err(format!(
            "its rotation has the determinant {determinant}: singular or mirrored"
        ));
    }
    let length = [0, 1, 2].map(|column| matrix.column(column).norm());
    let scale = (length[0] + length[1] + length[2]) / 3.0;
    let defect = |r: &Matrix3<f64>| (r.transpose() * r - Matrix3::identity()).abs().max();
    let mut rotation = if (scale - 1.0).abs() < ROTATION_EXACT {
        *matrix
    } else {
        matrix / scale
    };
    let off = defect(&rotation);
    if off.is_nan() || off > ROTATION_TOLERANCE {
        return Err(format!(
            "its columns are no rotation: lengths {length:?}, off by {off:.2e}, at most {ROTATION_TOLERANCE:e}"
        ));
    }
    if off > ROTATION_EXACT {
        // Each step of (R + R⁻ᵀ) / 2 squares the defect: 1e-3, 1e-6, 1e-12, done.
        for _ in 0..4 {
            let inverse = rotation.try_inverse().ok_or("its rotation cannot be inverted")?;
            rotation = (rotation + inverse.transpose()) / 2.0;
        }
    }
    Ok(rotation)
}

#[cfg(test)]
mod tests;
