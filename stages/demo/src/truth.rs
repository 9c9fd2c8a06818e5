//! Ground truth: for tests and for people, never read by the pipeline.

use marf_scene::{Cahvor, Camera, Pose};
use nalgebra::Matrix3;

use super::{
    lens::{Lens, RoverPose, rotation_columns},
    math::Vector,
    plan::FlawKind,
};

/// The ground truth of one sol.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// The good photos, in the order they were taken.
    pub photos: Vec<TruePhoto>,
    /// The flawed files.
    pub flaws: Vec<Flaw>,
}

/// A good photo's real camera. Frames as in the labels: x north, y east, z down, metres.
#[derive(Debug, Clone, PartialEq)]
pub struct TruePhoto {
    /// Name of the file.
    pub file: String,
    /// The true lens in the rover's frame. The label states a slightly different one.
    pub rover_model: Cahvor,
    /// The rover's true pose. The label states a slightly different one.
    pub site_from_rover: Pose,
    /// The same lens in the site frame.
    pub site_model: Cahvor,
    /// Pose of the ideal pinhole within the lens (x right, y down, z forward along A).
    pub cam_from_site: Pose,
    /// That pinhole, without the radial terms. Pixel (0, 0) is a corner.
    pub pinhole: Camera,
}

/// A flawed file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Flaw {
    /// Name of the file.
    pub file: String,
    /// Its flaw.
    pub kind: FlawKind,
    /// The good photo it was made from. Of an exact copy and its original, either may be kept.
    pub twin: Option<String>,
}

/// Distances along the rays of a photo's pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct RangeMap {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `[height * width]`, metres from the camera's centre along the pixel's ray. Infinite for the sky.
    pub range_m: Vec<f32>,
}

pub fn pose_of(rover: &RoverPose) -> Pose {
    Pose {
        rotation: Matrix3::from_columns(&rotation_columns(rover.attitude)),
        translation: rover.place,
    }
}

/// Returns the pinhole of a lens whose rows and columns are perpendicular, as those of the demo's lenses are.
pub fn pinhole_of(lens: &Lens, width: u32, height: u32) -> (Pose, Camera) {
    let right = lens.a.cross(&lens.h).cross(&lens.a);
    let down = lens.a.cross(&lens.v).cross(&lens.a);
    let rows = [right.unit(), down.unit(), lens.a].map(|row| row.transpose());
    let rotation = Matrix3::from_rows(&rows);
    let camera = Camera {
        fx_px: right.norm(),
        fy_px: down.norm(),
        cx_px: lens.a.dot(&lens.h) + 0.5,
        cy_px: lens.a.dot(&lens.v) + 0.5,
        ..Camera::pinhole(width, height, 1.0)
    };
    let pose = Pose {
        rotation,
        translation: -(rotation * lens.c),
    };
    (pose, camera)
}
