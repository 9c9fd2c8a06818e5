//! Rendering of a photo.

use marf_scene::{Image, Srgb};
use rayon::prelude::*;

use super::{
    lens::Lens,
    math::{SrgbEncoder, V3, v3},
    world::{RaySample, Surface, World},
};

/// Offsets of the four additional rays of an edge pixel, pixels.
const CORNERS: [(f64, f64); 4] = [(-0.375, -0.125), (0.125, -0.375), (0.375, 0.125), (-0.125, 0.375)];
/// Relative difference of range above which two neighbours are on an edge.
const EDGE: f64 = 0.03;

/// Share of a pixel's light that falls on each neighbour along a row or column: about 0.6 pixels of blur, as
/// good optics have. It also suppresses aliasing of the point samples.
const SPREAD: f64 = 0.17;

/// A camera in the site frame (z down), and what it photographs.
pub struct Shot<'a> {
    pub world: &'a World,
    pub lens: Lens,
    pub width: u32,
    pub height: u32,
}

impl Shot<'_> {
    /// Renders the photo, rows in parallel. Every pixel is a function of its position alone.
    pub fn photo(&self, encoder: &SrgbEncoder) -> Image<Srgb> {
        let first: Vec<RaySample> = self.each(|_, x, y| self.trace(x, y));
        let light = self.each(|index, x, y| {
            if !self.is_edge(&first, index) {
                return first[index].light;
            }
            let corners = CORNERS.iter().map(|(dx, dy)| self.trace(x + dx, y + dy).light);
            corners.fold(first[index].light, |sum, light| sum + light) * 0.2
        });
        Image {
            width: self.width,
            height: self.height,
            pixels: self.each(|index, _, _| encoder.rgb(self.spread(&light, index))),
        }
    }

    /// Returns the light on a pixel after the lens's blur. The border is repeated.
    fn spread(&self, light: &[V3], index: usize) -> V3 {
        let (width, height) = (self.width as usize, self.height as usize);
        let (x, y) = (index % width, index / width);
        let along_row = |row: usize| {
            let at = |column: usize| light[row * width + column];
            at(x) * (1.0 - 2.0 * SPREAD) + (at(x.saturating_sub(1)) + at((x + 1).min(width - 1))) * SPREAD
        };
        along_row(y) * (1.0 - 2.0 * SPREAD)
            + (along_row(y.saturating_sub(1)) + along_row((y + 1).min(height - 1))) * SPREAD
    }

    /// Returns the distance from the camera's centre along each pixel's ray, metres. Infinite for the sky.
    pub fn ranges_m(&self) -> Vec<f32> {
        self.each(|_, x, y| {
            let (from, along) = self.ray(x, y);
            self.world.range_m(from, along) as f32
        })
    }

    /// Returns the values of a function of each pixel's index, column and row.
    fn each<T: Send>(&self, pixel: impl Fn(usize, f64, f64) -> T + Sync) -> Vec<T> {
        let width = self.width as usize;
        (0..width * self.height as usize)
            .into_par_iter()
            .map(|index| pixel(index, (index % width) as f64, (index / width) as f64))
            .collect()
    }

    fn trace(&self, x: f64, y: f64) -> RaySample {
        let (from, along) = self.ray(x, y);
        self.world
            .trace(from, along, 1.0 / self.lens.h.cross(&self.lens.a).norm())
    }

    /// Traces a pixel's ray. z is up in the world and down in the site.
    fn ray(&self, x: f64, y: f64) -> (V3, V3) {
        let up = |p: V3| v3(p.x, p.y, -p.z);
        (up(self.lens.c), up(self.lens.ray(x, y)))
    }

    fn is_edge(&self, samples: &[RaySample], index: usize) -> bool {
        let width = self.width as usize;
        let column = index % width;
        let neighbours = [
            (column > 0).then(|| index - 1),
            (column + 1 < width).then_some(index + 1),
            index.checked_sub(width),
            Some(index + width).filter(|&below| below < samples.len()),
        ];
        let mut neighbours = neighbours.into_iter().flatten();
        neighbours.any(|other| differs(&samples[index], &samples[other]))
    }
}

fn differs(here: &RaySample, there: &RaySample) -> bool {
    if here.surface == Surface::Sky && there.surface == Surface::Sky {
        // The outline of the hills.
        return (here.light - there.light).norm() > 0.03;
    }
    (here.surface, here.is_shaded) != (there.surface, there.is_shaded)
        || (here.range_m - there.range_m).abs() > EDGE * here.range_m
}
