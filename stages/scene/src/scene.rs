//! A calibrated scene: photos with cameras and poses, and sparse points.

use marf_cache::Digest;
use serde::{Deserialize, Serialize};

use crate::{Camera, Pose, Tones};

/// A calibrated scene: the camera and the pose of each photo.
///
/// Frames are sorted by id, so that equal scenes have equal encodings.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Photos with a camera, sorted by id.
    pub frames: Vec<Frame>,
    /// Photos that could not be placed, with the reason.
    #[serde(default)]
    pub unplaced: Vec<Unplaced>,
    /// Sparse points. Empty if the method finds none.
    #[serde(default)]
    pub points: Vec<Point>,
    /// Unit vector that points up in the world, if known.
    #[serde(default)]
    pub up: Option<[f64; 3]>,
    /// Metres per unit of the world, if known.
    #[serde(default)]
    pub metres_per_unit: Option<f64>,
    /// The world's frame in the site of its labels. Scenes of one site share the site's frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site: Option<SiteFrame>,
    /// What matched points say of the photos' exposures. Absent if photos share too few.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tones: Option<Tones>,
    /// Name of the method and what it did to the photos (`resampled to an ideal pinhole`).
    #[serde(default)]
    pub method: String,
}

/// Position of a world in the frame of a site (x north, y east, z down, metres). Its axes are those of the site, its unit is the metre.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SiteFrame {
    /// Number of the site.
    pub site: i64,
    /// The world's origin in the site, metres.
    pub origin_m: [f64; 3],
}

/// A photo with its camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Frame {
    /// Id of the photo.
    pub id: String,
    /// File name for people and for exports.
    pub file: String,
    /// Digest of the image these cameras are for (resampled ones differ from the archive's).
    pub image: Digest,
    /// Digest of its mask, a picture of the same size. Pixels that are not white are hidden, and neither learnt from nor judged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mask: Option<Digest>,
    /// Its camera.
    pub camera: Camera,
    /// Its pose: x_cam = R x_world + t, with x right, y down, z forward.
    pub cam_from_world: Pose,
    /// Whether the photo is kept out of training, to measure quality.
    pub held_out: bool,
    /// Mean reprojection error, pixels, if measured.
    #[serde(default)]
    pub error_px: Option<f64>,
}

/// A photo without a camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Unplaced {
    /// Id of the photo.
    pub id: String,
    /// The reason, in one line.
    pub reason: String,
}

/// A sparse point of the surface.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Position in the world.
    pub position: [f64; 3],
    /// Its colour in sRGB, if known.
    #[serde(default)]
    pub color: Option<[u8; 3]>,
    /// Number of photos that see it.
    #[serde(default)]
    pub views: u32,
}

/// A scene that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The bytes are not a scene.
    #[error("not a scene: {0}")]
    Malformed(#[from] serde_json::Error),
    /// A frame with a camera or pose that is not finite or not proper.
    #[error("frame `{id}`: camera or pose is not finite, not positive or not a rotation")]
    BadFrame {
        /// The frame.
        id: String,
    },
}

impl Scene {
    /// Returns the frame of a photo, by its id.
    pub fn frame(&self, id: &str) -> Option<&Frame> {
        let found = self.frames.binary_search_by(|frame| frame.id.as_str().cmp(id));
        Some(&self.frames[found.ok()?])
    }

    /// Returns the scene as JSON. Floats are the shortest text that reads back to the same bits.
    ///
    /// # Errors
    /// Names a frame that is not finite: JSON would turn it into null.
    pub fn encode(&self) -> Result<Vec<u8>, SceneError> {
        self.check()?;
        Ok(serde_json::to_vec(self)?)
    }

    /// Reads what [`Scene::encode`] wrote and checks it.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn decode(bytes: &[u8]) -> Result<Self, SceneError> {
        let scene: Self = serde_json::from_slice(bytes)?;
        scene.check()?;
        Ok(scene)
    }

    /// Checks that all cameras and poses are valid.
    fn check(&self) -> Result<(), SceneError> {
        let valid = |frame: &Frame| frame.camera.is_valid() && frame.cam_from_world.is_valid();
        match self.frames.iter().find(|frame| !valid(frame)) {
            Some(frame) => Err(SceneError::BadFrame { id: frame.id.clone() }),
            None => Ok(()),
        }
    }
}
