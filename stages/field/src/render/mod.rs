//! Pictures of a field on the CPU: strips of rows in parallel, rays in waves, what neighbours agree on in between.

mod bundle;
mod lattice;
#[cfg(test)]
mod tests;
mod wave;

use std::ops::Range;

use marf_scene::{Camera, Pose};
use rayon::prelude::*;

use crate::cpu::clearance::Clearance;
#[cfg(test)]
use crate::cpu::composite::OPAQUE;
use crate::cpu::march::Steps;
use crate::cpu::simd::{InstructionSet, Run};
use crate::frame::RayStart;
use crate::model::Model;
use crate::picture::Render;
use bundle::{Bundle, NearMatter};
use lattice::{Lattice, STRIP, TILE};
use wave::Wave;

/// Every sample lies in the middle of its step.
pub(crate) const MIDDLE: f32 = 0.5;

/// How far a picture may be from the exact quadrature of every ray; `benches/field.md` has the price of each number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accuracy {
    /// Transmittance below which a ray ends; what is behind takes the colour found so far.
    pub opaque: f32,
    /// Samples on a ray are joined until they weigh this much, and share the colour of the heaviest.
    pub joined: f32,
    /// Difference of colour (sRGB in [0, 1]) and opacity below which traced pixels are taken for alike: a pixel between
    /// them is interpolated and not traced. 0: all are traced.
    pub alike: f32,
}

impl Accuracy {
    /// Every sample of every ray.
    #[cfg(test)]
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

impl Viewpoint<'_> {
    /// Renders some rows of a photo; strips run in parallel.
    ///
    /// A pixel depends on the rays of its strip, which is the same whatever rows are asked for and whatever the pool.
    pub fn rows(&self, rows: Range<u32>) -> Render {
        let strips = rows.start / STRIP..rows.end.div_ceil(STRIP);
        let strips = strips.into_par_iter().map_init(Wave::default, |wave, index| {
            let strip = self.strip(wave, index * STRIP);
            let kept = rows.start.max(index * STRIP)..rows.end.min((index + 1) * STRIP);
            let pixel = |row: u32| ((row - index * STRIP) * strip.width) as usize;
            let kept = pixel(kept.start)..pixel(kept.end);
            (strip, kept)
        });
        let mut whole = Render::empty(self.camera.width, 0);
        for (strip, kept) in strips.collect::<Vec<_>>() {
            whole.rgb.extend_from_slice(&strip.rgb[kept.clone()]);
            whole.opacity.extend_from_slice(&strip.opacity[kept.clone()]);
            whole.depth.extend_from_slice(&strip.depth[kept]);
        }
        Render {
            height: rows.end.saturating_sub(rows.start),
            ..whole
        }
    }

    /// Renders the strip whose first row is `top`.
    fn strip(&self, wave: &mut Wave, top: u32) -> Render {
        let rays = StripRays::new(self, top);
        let mut strip = Render::empty(self.camera.width, rays.height);
        let lattice = Lattice::new(strip.width, strip.height);
        wave.trace(self, &rays, &lattice.knots(), &mut strip);
        let mut others = lattice.others();
        others.retain(|pixel| !lattice.interpolate(&mut strip, *pixel, self.accuracy.alike));
        wave.trace(self, &rays, &others, &mut strip);
        strip
    }
}

/// Renders every sample of every ray of a photo.
#[cfg(all(test, feature = "gpu"))]
pub fn exact(model: &Model, camera: &Camera, cam_from_world: &Pose) -> Render {
    let viewpoint = Viewpoint {
        level: InstructionSet::best(),
        model,
        clearance: &Clearance::new(&model.bits),
        camera,
        world_from_cam: cam_from_world.inverse(),
        accuracy: Accuracy::EXACT,
    };
    viewpoint.rows(0..camera.height)
}

/// The rays of a strip.
struct StripRays {
    height: u32,
    /// `[height * width]`; none where the distortion has no inverse.
    starts: Vec<Option<RayStart>>,
    /// Steps near matter, tile by tile.
    steps: Vec<Steps>,
}

impl StripRays {
    fn new(view: &Viewpoint, top: u32) -> Self {
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
