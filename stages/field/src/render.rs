use marf_scene::{Camera, Image, Pose, Srgb};
use rayon::prelude::*;

use crate::cpu::composite::OPAQUE;
use crate::cpu::march::March;
use crate::frame::RayStart;
use crate::shade::{Shade, Span};
use crate::{Field, sh};

/// A rendered photo, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Render {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `[height * width]`, sRGB in [0, 1].
    pub rgb: Vec<[f32; 3]>,
    /// `[height * width]`, share of the ray that met matter, in [0, 1].
    pub opacity: Vec<f32>,
    /// `[height * width]`, expected distance along the ray, world units; 0 where opacity is 0. Never NaN.
    pub depth: Vec<f32>,
}

impl Render {
    /// Rounds to 8 bits.
    pub fn to_image(&self) -> Image<Srgb> {
        let pixels = self.rgb.iter();
        let round = |value: f32| (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        Image {
            width: self.width,
            height: self.height,
            pixels: pixels.map(|rgb| rgb.map(round)).collect(),
        }
    }
}

/// Samples a ray gets in the first round; later rounds, with fewer rays left, take twice as many.
const FIRST_ROUND: usize = 8;
/// Every sample lies in the middle of its step.
const MIDDLE: f32 = 0.5;

/// A ray on its way.
struct Walk {
    pixel: usize,
    start: RayStart,
    harmonics: [f32; sh::COUNT],
    next_step: usize,
    optical_depth: f32,
    rgb: [f32; 3],
    /// Sum of weight times distance, half sides.
    distance: f32,
    left: f32,
}

/// A finished pixel.
#[derive(Clone, Copy, Default)]
struct Pixel {
    rgb: [f32; 3],
    opacity: f32,
    depth: f32,
}

/// Renders row by row in the current pool.
pub fn render(field: &Field, camera: &Camera, cam_from_world: &Pose) -> Render {
    let world_from_cam = cam_from_world.inverse();
    let rows = (0..camera.height).into_par_iter();
    let rows = rows.map_init(Shade::default, |shade, row| {
        render_row(field, shade, camera, &world_from_cam, row)
    });
    let pixels = rows.collect::<Vec<_>>().concat();
    Render {
        width: camera.width,
        height: camera.height,
        rgb: pixels.iter().map(|pixel| pixel.rgb).collect(),
        opacity: pixels.iter().map(|pixel| pixel.opacity).collect(),
        depth: pixels.iter().map(|pixel| pixel.depth).collect(),
    }
}

fn render_row(
    field: &Field,
    shade: &mut Shade,
    camera: &Camera,
    world_from_cam: &Pose,
    row: u32,
) -> Vec<Pixel> {
    let mut pixels = vec![Pixel::default(); camera.width as usize];
    let columns = 0..camera.width;
    let mut walks: Vec<Walk> = columns
        .filter_map(|column| {
            let centre = [f64::from(column) + 0.5, f64::from(row) + 0.5];
            let start = field.frame.ray(camera, world_from_cam, centre)?;
            Some(Walk::new(column as usize, start))
        })
        .collect();
    let mut limit = FIRST_ROUND;
    while !walks.is_empty() {
        advance(field, shade, &mut walks, limit);
        limit *= 2;
        walks.retain(|walk| {
            let done = walk.left < OPAQUE || walk.next_step >= field.steps.begin.len();
            if done {
                pixels[walk.pixel] = walk.finish(field);
            }
            !done
        });
    }
    pixels
}

impl Walk {
    fn new(pixel: usize, start: RayStart) -> Self {
        Self {
            pixel,
            start,
            harmonics: sh::harmonics(start.direction),
            next_step: 0,
            optical_depth: 0.0,
            rgb: [0.0; 3],
            distance: 0.0,
            left: 1.0,
        }
    }

    fn finish(&self, field: &Field) -> Pixel {
        let behind = field.weights.behind(field.config.background, &self.harmonics);
        let opacity = (1.0 - self.left).clamp(0.0, 1.0);
        let half_side = field.frame.half_side as f32;
        let depth = if opacity > 0.0 {
            self.distance / opacity * half_side
        } else {
            0.0
        };
        Pixel {
            rgb: [0, 1, 2].map(|channel| self.left.mul_add(behind[channel], self.rgb[channel])),
            opacity,
            depth: if depth.is_finite() { depth } else { 0.0 },
        }
    }
}

/// Carries every ray over its next occupied samples.
fn advance(field: &Field, shade: &mut Shade, walks: &mut [Walk], limit: usize) {
    shade.samples.resize(0);
    let mut spans = Vec::with_capacity(walks.len());
    for walk in walks.iter_mut() {
        let first = shade.samples.len();
        walk.next_step = field.level.run(March {
            steps: &field.steps,
            bits: &field.bits,
            origin: walk.start.origin,
            direction: walk.start.direction,
            jitter: MIDDLE,
            first: walk.next_step,
            limit,
            samples: &mut shade.samples,
        });
        let end = shade.samples.len();
        spans.push(Span { first, end });
    }
    let before: Vec<f32> = walks.iter().map(|walk| walk.optical_depth).collect();
    shade.densities(field.level, &field.weights);
    shade.opacities(field.level, &spans, &before);
    let depths: Vec<f32> = spans
        .iter()
        .map(|span| shade.tau[span.first..span.end].iter().sum())
        .collect();
    let mut kept = Vec::new();
    shade.drop_hidden(&mut spans, &mut kept);
    let harmonics: Vec<_> = walks.iter().map(|walk| walk.harmonics).collect();
    shade.colours(field.level, &field.weights, &spans, &harmonics);
    for ((walk, span), depth) in walks.iter_mut().zip(&spans).zip(&depths) {
        walk.optical_depth += depth;
        for index in span.first..span.end {
            let weight = shade.transmittance[index] * shade.alpha[index];
            for channel in 0..3 {
                walk.rgb[channel] = weight.mul_add(shade.rgb[index][channel], walk.rgb[channel]);
            }
            walk.distance = weight.mul_add(shade.samples.t[index], walk.distance);
            walk.left = shade.transmittance[index] - weight;
        }
        if walk.optical_depth > 9.3 {
            walk.left = walk.left.min(OPAQUE * 0.5);
        }
    }
}
