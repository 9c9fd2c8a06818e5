//! The result of a method, before it becomes a scene.

use marf_cache::Digest;
use marf_scene::{Camera, Point, Pose, SiteFrame};
use marf_schema::calibrate::Missing;
use marf_sfm::mapper::PoseUncertainty;
use marf_sfm::rigs::StereoPair;

use crate::export::TrackPoint;
use crate::up::{FoundUp, find_up};

/// A photo with a camera, before held-out photos are chosen.
pub(crate) struct PlacedPhoto {
    /// Index in the input set.
    pub item: usize,
    /// File name for people and exports. A re-encoded photo has another extension.
    pub file: String,
    pub image: Digest,
    /// Its mask before it is reduced, where the import names one or has made one.
    pub mask: Option<Digest>,
    pub camera: Camera,
    pub cam_from_world: Pose,
    /// Whether the import holds it out, if it says so.
    pub held_out: Option<HeldOut>,
    pub statistics: PhotoStatistics,
}

/// What the method knows of a photo's features and errors.
#[derive(Debug, Clone, Default)]
pub(crate) struct PhotoStatistics {
    pub features: Option<u32>,
    pub matches: Option<u32>,
    pub inliers: Option<u32>,
    pub error_px: Option<f64>,
    pub error_working_px: Option<f64>,
    pub uncertainty: Option<PoseUncertainty>,
    /// A remark on its label.
    pub note: Option<String>,
}

/// Whether a photo is kept from training, for measuring.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum HeldOut {
    Yes,
    No,
}

/// The result of a method.
#[derive(Default)]
pub(crate) struct Calibration {
    pub placed: Vec<PlacedPhoto>,
    /// Index in the input set, and the reason.
    pub unplaced: Vec<(usize, String)>,
    /// Files that have a camera but are not in the input set.
    pub missing: Vec<Missing>,
    pub points: Vec<Point>,
    /// Points with their observations, if the method has them. The frame of an observation is the index in the input set.
    pub tracks: Vec<TrackPoint>,
    pub up: Option<FoundUp>,
    pub metres_per_unit: Option<f64>,
    /// The world's frame in the site of its labels.
    pub site: Option<SiteFrame>,
    /// Stereo pairs of photos, named by their index in the input set, if labels give them.
    pub stereo_pairs: Vec<StereoPair>,
    pub method: String,
    /// Statistics of each photo of the input set, placed or not. Empty if the method has none.
    pub statistics: Vec<PhotoStatistics>,
    /// Number of connected components of two and more photos, if the method knows it.
    pub components: Option<usize>,
    /// Why most of the others were not placed, if the method knows better than the most common reason.
    pub cause: Option<String>,
    /// What to try if too few photos were placed.
    pub hint: String,
}

/// Finds up of placed photos without labels.
pub(crate) fn up_of(placed: &[PlacedPhoto], points: &[Point]) -> Option<FoundUp> {
    let poses: Vec<&Pose> = placed.iter().map(|one| &one.cam_from_world).collect();
    find_up(&poses, points)
}
