//! Cameras and points as a file has them, and why a file is refused.

use marf_scene::{Point, Pose};
use marf_schema::calibrate::Missing;
use marf_stage::StageError;

use super::lens::Lens;

/// A camera file that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{file}`{}: {problem}", place_text(place))]
pub struct ImportError {
    /// Name of the file next to the photos.
    pub file: String,
    /// JSON pointer, line or record. Empty for the whole file.
    pub place: String,
    /// The fault, with the value.
    pub problem: String,
}

fn place_text(place: &str) -> String {
    if place.is_empty() {
        String::new()
    } else {
        format!(" {place}")
    }
}

impl ImportError {
    pub(super) fn new(file: &str, place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self {
            file: file.to_owned(),
            place: place.into(),
            problem: problem.into(),
        }
    }
}

/// A photo's camera as another program has it.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Its place in the file, for messages.
    pub place: String,
    /// The photo's name relative to the archive, with `/`, possibly without extension. A path from elsewhere starts with `/`.
    pub file: String,
    /// The name of its mask in the same form, if the file has one.
    pub mask: Option<String>,
    /// Its lens, before the photo's size is known.
    pub lens: Lens,
    /// Its pose: x right, y down, z forward.
    pub cam_from_world: Pose,
    /// What it is for.
    pub role: Role,
    /// Features found in the photo, if the file has their number.
    pub matches: Option<u32>,
    /// Those of them that belong to a point, if the file has their number.
    pub inliers: Option<u32>,
    /// Their mean distance from their points' projections, pixels of this lens.
    pub error_px: Option<f64>,
}

impl View {
    /// Returns whether another view has the same photo, lens and pose.
    pub(super) fn is_repeated_by(&self, other: &Self) -> bool {
        (self.lens, self.cam_from_world, &self.mask) == (other.lens, other.cam_from_world, &other.mask)
    }
}

/// The purpose of a photo in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Not specified.
    Open,
    /// Training.
    Train,
    /// Measuring.
    HeldOut,
    /// The file has lists of photos for training and measuring and this one is not in them.
    Unlisted,
}

/// Everything of a camera file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Cameras {
    /// One for each photo it has.
    pub views: Vec<View>,
    /// Sparse points, sorted by the file's own number, or in its order.
    pub points: Vec<Point>,
    /// Photos whose cameras cannot be used, with the reasons.
    pub rejected: Vec<Missing>,
}

/// Returns the error of a refused camera file.
pub(super) fn refused(error: ImportError) -> StageError {
    StageError::new(error.to_string())
        .hint("correct the file or write it again: none of its cameras was used".to_owned())
}
