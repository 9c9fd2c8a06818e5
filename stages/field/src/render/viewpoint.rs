//! What is rendered, how exactly, and the rays of a strip of it.

use marf_scene::{Camera, Pose};

use super::bundle::{Bundle, NearMatter};
use super::lattice::{STRIP, TILE};
use crate::cpu::clearance::Clearance;
use crate::cpu::composite::OPAQUE;
use crate::cpu::march::Steps;
use crate::cpu::simd::{InstructionSet, Run};
use crate::frame::RayStart;
use crate::model::Model;

/// How far a picture may be from the exact quadrature of every ray. `benches/field.md` has the price of each
/// number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accuracy {
    /// Transmittance below which a ray ends. Anything behind takes the colour found so far.
    pub opaque: f32,
    /// Samples on a ray are joined until they weigh this much, and share the colour of the heaviest.
    pub joined: f32,
    /// Difference of colour (sRGB in [0, 1]) and opacity below which traced pixels are taken for alike: a pixel between
    /// them is interpolated and not traced. 0: all are traced.
    pub alike: f32,
}

impl Accuracy {
    /// Every sample of every ray.
    pub const EXACT: Self = Self {
        opaque: OPAQUE,
        joined: 0.0,
        alike: 0.0,
    };
    /// Costs less than 0.05 dB.
    pub const PICTURE: Self = Self {
        opaque: 0.01,
        joined: 1.0 / 256.0,
        alike: 0.03,
    };
}

/// The view that is rendered.
pub struct Viewpoint<'a> {
    /// Instruction set.
    pub level: InstructionSet,
    /// The field.
    pub model: &'a Model,
    /// Its empty space.
    pub clearance: &'a Clearance,
    /// The camera.
    pub camera: &'a Camera,
    /// Where it stands.
    pub world_from_cam: Pose,
    /// How exact the picture is.
    pub accuracy: Accuracy,
}

/// The rays of a strip.
pub struct StripRays {
    /// Rows.
    pub height: u32,
    /// `[height * width]`. `None` where the distortion has no inverse.
    pub starts: Vec<Option<RayStart>>,
    /// Steps near matter, tile by tile.
    pub steps: Vec<Steps>,
}

impl StripRays {
    /// Sets out the rays of the strip whose first row is `top`.
    pub fn new(view: &Viewpoint, top: u32) -> Self {
        let Viewpoint { model, camera, .. } = view;
        let height = camera.height.saturating_sub(top).min(STRIP);
        let mut starts = Vec::with_capacity((height * camera.width) as usize);
        for row in top..top + height {
            for column in 0..camera.width {
                let centre = [f64::from(column) + 0.5, f64::from(row) + 0.5];
                starts.push(model.frame.ray(camera, &view.world_from_cam, centre));
            }
        }
        let tiles = (0..camera.width).step_by(TILE as usize).map(|left| {
            let columns = left as usize..camera.width.min(left + TILE) as usize;
            let rows = starts.chunks_exact(camera.width as usize);
            let bundle = Bundle::new(rows.flat_map(|row| row[columns.clone()].iter().flatten()));
            let near = bundle.map(|bundle| {
                view.level.run(NearMatter {
                    steps: &model.steps,
                    clearance: view.clearance,
                    bundle,
                })
            });
            near.unwrap_or_else(|| Steps::new(0.0, 0.0, 1.0, 0.0))
        });
        Self {
            height,
            steps: tiles.collect(),
            starts,
        }
    }
}
