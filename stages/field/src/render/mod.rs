//! Pictures of a field on the CPU: strips of rows in parallel, rays in waves, what neighbours agree on in between.

mod bundle;
mod lattice;
#[cfg(test)]
mod tests;
mod viewpoint;
mod wave;

use std::ops::Range;

use rayon::prelude::*;

use crate::picture::Render;
pub use bundle::MIDDLE;
use lattice::{Lattice, STRIP};
use viewpoint::StripRays;
pub use viewpoint::{Accuracy, Viewpoint};
use wave::Wave;

impl Viewpoint<'_> {
    /// Renders some rows of a photo. Strips run in parallel.
    ///
    /// A pixel depends on the rays of its strip, which is the same for any rows and any pool.
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
