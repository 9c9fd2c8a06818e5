//! transforms.json of instant-ngp and nerfstudio, and the split sets of the NeRF paper.

mod intrinsics;

use std::collections::BTreeSet;

use marf_schema::calibrate::Missing;
use serde_json::Value;

use super::cameras::{ImportError, Role, View};
use super::choose::folder;
use super::json_node::JsonNode;
use super::paths::{self, BYTE_ORDER_MARK};
use super::pose_matrix::pose;
use intrinsics::lens;

/// Key of the file of the sparse points, as in nerfstudio.
pub(super) const POINTS_KEY: &str = "ply_file_path";
/// Numbers that JSON does not have and Python writes.
const NO_NUMBERS: [&str; 3] = ["-Infinity", "Infinity", "NaN"];

/// Content of a transforms.json.
#[derive(Debug, Clone, PartialEq)]
pub struct Transforms {
    /// One for each frame that can be used.
    pub views: Vec<View>,
    /// The PLY with the sparse points of the same world, relative to the archive, if one is named.
    pub points: Option<String>,
    /// The other frames.
    pub rejected: Vec<Missing>,
}

/// Reads the cameras of a transforms.json.
///
/// Camera to world with x right, y up, z backward (OpenGL) becomes world to camera with x right, y down, z forward. Intrinsics are at the
/// top or in a frame, and those of the frame take precedence. Without `fl_x` the focal length comes from `camera_angle_x`. Without `w` and
/// `h` they are for the photo's size. Missing lens terms are 0. A uniform scale of the rotation is divided out. The last row of a matrix
/// may be missing.
///
/// `train_filenames`, `val_filenames` and `test_filenames` decide what is measured. A photo in several of them is measured. `file` names
/// the JSON relative to the archive. The names in it are relative to its folder. Of the sparse points only the file's name,
/// `ply_file_path`, is read. A byte order mark is skipped. NaN and infinities matter only where a number is needed.
///
/// # Errors
/// Names the place in the file: not JSON, nesting deeper than 128, no frame that can be used. A frame is rejected for a missing or
/// non-finite number, a focal length or size that is not positive, a matrix that is singular, mirrored or sheared, or an unsupported lens.
pub fn read_transforms(file: &str, bytes: &[u8]) -> Result<Transforms, ImportError> {
    let value = parse(bytes).map_err(|error| ImportError::new(file, "", format!("not JSON: {error}")))?;
    let root = JsonNode::root(file, &value);
    if !value.is_object() {
        return Err(root.error("not an object with `frames`"));
    }
    let roles = Roles::read(&root)?;
    let frames = root.required("frames")?.items()?;
    if frames.is_empty() {
        return Err(root.error("`frames` is empty"));
    }
    let (mut views, mut errors, mut rejected) = (Vec::new(), Vec::new(), Vec::new());
    for frame in &frames {
        match view(&root, frame, &roles) {
            Ok(view) => views.push(view),
            Err(error) => {
                let name = frame.get("file_path").and_then(|node| path(&node).ok());
                rejected.push(Missing {
                    file: name.unwrap_or_else(|| frame.pointer.clone()),
                    reason: format!("{} {}", error.place, error.problem),
                });
                errors.push(error);
            }
        }
    }
    if let (true, Some(error)) = (views.is_empty(), errors.into_iter().next()) {
        return Err(error);
    }
    let points = root.get(POINTS_KEY).map(|node| path(&node));
    Ok(Transforms {
        views,
        points: points.transpose()?,
        rejected,
    })
}

/// Returns the names of photos and masks in a transforms.json, as they are written. Empty for any other content.
pub fn names_in_transforms(bytes: &[u8]) -> Vec<String> {
    let value = parse(bytes).unwrap_or_default();
    let frames = value["frames"].as_array().map(Vec::as_slice).unwrap_or_default();
    let names = frames
        .iter()
        .flat_map(|frame| [&frame["file_path"], &frame["mask_path"]]);
    names.filter_map(|name| Some(name.as_str()?.to_owned())).collect()
}

/// Parses JSON as Python writes it: NaN and infinities become texts.
fn parse(bytes: &[u8]) -> Result<Value, serde_json::Error> {
    let bytes = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    serde_json::from_slice(bytes).or_else(|error| match std::str::from_utf8(bytes) {
        Ok(text) if NO_NUMBERS.iter().any(|word| text.contains(word)) => serde_json::from_str(&quoted(text)),
        _ => Err(error),
    })
}

/// Puts NaN and infinities outside of texts in quotes.
fn quoted(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let (mut rest, mut is_in_text) = (text, false);
    while let Some(letter) = rest.chars().next() {
        let word = NO_NUMBERS
            .iter()
            .find(|word| !is_in_text && rest.starts_with(**word));
        let taken = match (word, letter) {
            (Some(word), _) => {
                out.extend(["\"", word, "\""]);
                word.len()
            }
            (None, '\\') if is_in_text => {
                let taken = 1 + rest[1..].chars().next().map_or(0, char::len_utf8);
                out.push_str(&rest[..taken]);
                taken
            }
            (None, letter) => {
                is_in_text ^= letter == '"';
                out.push(letter);
                letter.len_utf8()
            }
        };
        rest = &rest[taken..];
    }
    out
}

/// Returns the view of a frame.
fn view(root: &JsonNode<'_>, frame: &JsonNode<'_>, roles: &Roles) -> Result<View, ImportError> {
    let name = path(&frame.required("file_path")?)?;
    let mask = frame.get("mask_path").map(|node| path(&node)).transpose()?;
    Ok(View {
        place: frame.pointer.clone(),
        role: roles.role(&name),
        file: name,
        mask,
        lens: lens(root, frame)?,
        cam_from_world: pose(&frame.required("transform_matrix")?)?,
        matches: None,
        inliers: None,
        error_px: None,
    })
}

/// A path as the archive has it.
fn path(node: &JsonNode<'_>) -> Result<String, ImportError> {
    paths::path(&folder(node.file), node.text()?).ok_or_else(|| node.error("an empty name"))
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

#[cfg(test)]
mod tests;
