//! Gaussian splats of a field's surface: flat discs where its views show one, coloured so that pictures of them are the field's.
//!
//! Nothing is trained but colours, and these by a linear problem: places, directions, sizes and opacities are the field's own.

mod colors;
pub mod file;
mod floating;
mod judge;
mod place;
mod raster;
pub mod stage;

use nalgebra::Vector3;

pub use colors::adjust_colors;
pub use floating::without_floating;
pub use judge::{SplatComparison, judge};
pub use place::place;
pub use raster::{Footprint, Raster};

use marf_scene::{Camera, Pose};

/// Thickness of a disc, in its standard deviations.
pub const THIN: f64 = 0.1;
/// Standard deviation of a splat, in sides of its cell: on the demo 0.35 gains 0.3 dB at the views of photos, and gapes nearer to the ground.
const SIGMA: f64 = 0.5;

/// A flat Gaussian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Splat {
    /// Centre, world units.
    pub position: Vector3<f64>,
    /// Unit normal of the disc.
    pub normal: Vector3<f64>,
    /// Standard deviation within the disc, world units.
    pub sigma: f64,
    /// sRGB in [0, 1].
    pub color: [f32; 3],
    /// Share of the light that its centre takes, in (0, 0.99].
    pub opacity: f32,
}

impl Splat {
    /// Returns the side of the cell that it represents, world units.
    pub fn width(&self) -> f64 {
        self.sigma / SIGMA
    }
}

/// Picture of a field at a view.
#[derive(Debug, Clone, Copy)]
pub struct Picture<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// Its pose.
    pub cam_from_world: &'a Pose,
    /// `[height * width]`, sRGB in [0, 1].
    pub rgb: &'a [[f32; 3]],
    /// `[height * width]`, in [0, 1]. 0 if the field shows no surface or a mask hides it: such pixels are not
    /// compared.
    pub opacity: &'a [f32],
}
