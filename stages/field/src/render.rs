use std::ops::Range;

use marf_scene::{Camera, Pose};
use rayon::prelude::*;

use crate::cpu::composite::OPAQUE;
use crate::cpu::march::March;
use crate::cpu::simd::{InstructionSet, Isa, Kernel, Run};
use crate::frame::RayStart;
use crate::model::Model;
use crate::picture::Render;
use crate::sh;
use crate::shade::{Shade, Span};

/// Samples a ray gets in the first round; later rounds, with fewer rays left, take twice as many.
const FIRST_ROUND: usize = 8;
/// Optical depth that ends a ray: e^-9.3 is below [`OPAQUE`].
pub(crate) const DEEP: f32 = 9.3;
/// Every sample lies in the middle of its step.
pub(crate) const MIDDLE: f32 = 0.5;
/// Samples on a ray are joined until they weigh this much and share the colour of the last: half a step of 8 bits.
const FAINT: f32 = 1.0 / 512.0;
/// Rows and columns of a tile: the samples of 256 neighbouring rays, some 2 KB a ray, stay in the second cache.
const TILE: [u32; 2] = [8, 32];

/// A ray on its way.
struct Walk {
    /// Its pixel in the tile, by rows.
    pixel: usize,
    start: RayStart,
    next_step: usize,
    optical_depth: f32,
    rgb: [f32; 3],
    /// Sum of weight times distance, half sides.
    distance: f32,
    left: f32,
    /// Weight of samples that have no colour yet.
    faint: f32,
}

/// A finished pixel.
#[derive(Clone, Copy)]
struct Pixel {
    rgb: [f32; 3],
    opacity: f32,
    depth: f32,
}

/// Memory of one worker, and its tile.
#[derive(Default)]
struct Tile {
    shade: Shade,
    walks: Vec<Walk>,
    /// Those of the walks' directions, in their order.
    harmonics: Vec<[f32; sh::COUNT]>,
    spans: Vec<Span>,
    /// Optical depth in front of a round.
    before: Vec<f32>,
    /// Samples whose colour is asked for, and the weight it gets.
    kept: Vec<u32>,
    weights: Vec<f32>,
}

/// The view that is rendered.
struct Viewpoint<'a> {
    level: InstructionSet,
    model: &'a Model,
    camera: &'a Camera,
    world_from_cam: Pose,
}

/// Some rows of the pixels of a [`Render`].
struct Strip<'a> {
    top: u32,
    rgb: &'a mut [[f32; 3]],
    opacity: &'a mut [f32],
    depth: &'a mut [f32],
}

/// Renders some rows of a photo; strips of tiles run in parallel.
///
/// A pixel depends on nothing but its ray, hence neither on the rows asked for nor on the pool.
pub fn render_rows(
    level: InstructionSet,
    model: &Model,
    camera: &Camera,
    cam_from_world: &Pose,
    rows: Range<u32>,
) -> Render {
    let viewpoint = Viewpoint {
        level,
        model,
        camera,
        world_from_cam: cam_from_world.inverse(),
    };
    let mut whole = Render::empty(camera.width, rows.end.saturating_sub(rows.start));
    let pixels = (TILE[0] * camera.width.max(1)) as usize;
    let strips = whole
        .rgb
        .par_chunks_mut(pixels)
        .zip(whole.opacity.par_chunks_mut(pixels))
        .zip(whole.depth.par_chunks_mut(pixels))
        .enumerate();
    strips.for_each_init(Tile::default, |tile, (index, ((rgb, opacity), depth))| {
        let top = rows.start + index as u32 * TILE[0];
        let strip = &mut Strip {
            top,
            rgb,
            opacity,
            depth,
        };
        for left in (0..camera.width).step_by(TILE[1] as usize) {
            tile.render(&viewpoint, strip, left);
        }
    });
    whole
}

impl Tile {
    fn render(&mut self, viewpoint: &Viewpoint, strip: &mut Strip, left: u32) {
        self.begin(viewpoint, strip, left);
        let mut limit = FIRST_ROUND;
        while !self.walks.is_empty() {
            self.advance(viewpoint, limit);
            limit *= 2;
            self.finish(viewpoint.model, strip);
        }
    }

    /// Sets out a ray for every pixel of the tile that has one.
    fn begin(&mut self, viewpoint: &Viewpoint, strip: &Strip, left: u32) {
        let width = viewpoint.camera.width;
        let rows = strip.rgb.len() as u32 / width.max(1);
        for row in 0..rows {
            for column in left..width.min(left + TILE[1]) {
                let centre = [f64::from(column) + 0.5, f64::from(strip.top + row) + 0.5];
                let frame = &viewpoint.model.frame;
                let Some(start) = frame.ray(viewpoint.camera, &viewpoint.world_from_cam, centre) else {
                    continue;
                };
                self.harmonics.push(sh::harmonics(start.direction));
                self.walks.push(Walk {
                    pixel: (row * width + column) as usize,
                    start,
                    next_step: 0,
                    optical_depth: 0.0,
                    rgb: [0.0; 3],
                    distance: 0.0,
                    left: 1.0,
                    faint: 0.0,
                });
            }
        }
    }

    /// Carries every ray over its next occupied samples.
    fn advance(&mut self, viewpoint: &Viewpoint, limit: usize) {
        let Viewpoint { level, model, .. } = *viewpoint;
        let shade = &mut self.shade;
        shade.samples.resize(0);
        self.spans.clear();
        for walk in &mut self.walks {
            let first = shade.samples.len();
            walk.next_step = level.run(March {
                steps: &model.steps,
                bits: &model.bits,
                origin: walk.start.origin,
                direction: walk.start.direction,
                jitter: MIDDLE,
                first: walk.next_step,
                limit,
                samples: &mut shade.samples,
            });
            let end = shade.samples.len();
            self.spans.push(Span { first, end });
        }
        self.before.clear();
        self.before
            .extend(self.walks.iter().map(|walk| walk.optical_depth));
        shade.densities(level, &model.weights);
        shade.opacities(level, &self.spans, &self.before);
        self.kept.clear();
        self.weights.clear();
        level.run(Weigh {
            walks: &mut self.walks,
            spans: &mut self.spans,
            shade,
            kept: &mut self.kept,
            weights: &mut self.weights,
        });
        shade.keep_latent(&self.kept);
        shade.colours(level, &model.weights, &self.spans, &self.harmonics);
        level.run(Gather {
            walks: &mut self.walks,
            spans: &self.spans,
            rgb: &shade.rgb,
            weights: &self.weights,
        });
    }

    /// Writes the rays that are done and keeps the others.
    fn finish(&mut self, model: &Model, strip: &mut Strip) {
        let mut going_on = 0;
        for index in 0..self.walks.len() {
            let walk = &self.walks[index];
            if walk.left >= OPAQUE && walk.next_step < model.steps.begin.len() {
                self.walks.swap(going_on, index);
                self.harmonics.swap(going_on, index);
                going_on += 1;
                continue;
            }
            let pixel = walk.pixel(model, &self.harmonics[index]);
            strip.rgb[walk.pixel] = pixel.rgb;
            strip.opacity[walk.pixel] = pixel.opacity;
            strip.depth[walk.pixel] = pixel.depth;
        }
        self.walks.truncate(going_on);
        self.harmonics.truncate(going_on);
    }
}

/// Takes the densities of a round into the rays and chooses the samples whose colour counts; spans then point to
/// these. Compiled for the instruction set, or each fused multiply-add is a call.
struct Weigh<'a> {
    walks: &'a mut [Walk],
    spans: &'a mut [Span],
    shade: &'a Shade,
    kept: &'a mut Vec<u32>,
    weights: &'a mut Vec<f32>,
}

impl Kernel for Weigh<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        let shade = self.shade;
        for (walk, span) in self.walks.iter_mut().zip(self.spans) {
            let first = self.kept.len();
            walk.optical_depth += shade.tau[span.first..span.end].iter().sum::<f32>();
            for index in span.first..span.end {
                let before = shade.transmittance[index];
                if before < OPAQUE {
                    break;
                }
                let weight = before * shade.alpha[index];
                walk.distance = weight.mul_add(shade.samples.t[index], walk.distance);
                walk.left = before - weight;
                walk.faint += weight;
                if walk.faint >= FAINT {
                    self.kept.push(index as u32);
                    self.weights.push(walk.faint);
                    walk.faint = 0.0;
                }
            }
            if walk.optical_depth > DEEP {
                walk.left = walk.left.min(OPAQUE * 0.5);
            }
            let end = self.kept.len();
            *span = Span { first, end };
        }
    }
}

/// Adds the colours of a round to the rays.
struct Gather<'a> {
    walks: &'a mut [Walk],
    spans: &'a [Span],
    rgb: &'a [[f32; 4]],
    weights: &'a [f32],
}

impl Kernel for Gather<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        for (walk, span) in self.walks.iter_mut().zip(self.spans) {
            for index in span.first..span.end {
                for channel in 0..3 {
                    let rgb = self.rgb[index][channel];
                    walk.rgb[channel] = self.weights[index].mul_add(rgb, walk.rgb[channel]);
                }
            }
        }
    }
}

impl Walk {
    fn pixel(&self, model: &Model, harmonics: &[f32; sh::COUNT]) -> Pixel {
        let behind = model.weights.behind(model.config.background, harmonics);
        // What was too faint for a colour of its own takes the one behind it.
        let through = self.left + self.faint;
        let opacity = (1.0 - self.left).clamp(0.0, 1.0);
        let half_side = model.frame.half_side as f32;
        let depth = if opacity > 0.0 {
            self.distance / opacity * half_side
        } else {
            0.0
        };
        Pixel {
            rgb: [0, 1, 2].map(|channel| through.mul_add(behind[channel], self.rgb[channel])),
            opacity,
            depth: if depth.is_finite() { depth } else { 0.0 },
        }
    }
}
