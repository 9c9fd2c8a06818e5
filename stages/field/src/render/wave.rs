//! Rays that are traced together: as one ends, the next one takes its place.

use super::bundle::MIDDLE;
use super::lattice::TILE;
use super::viewpoint::{Accuracy, StripRays, Viewpoint};
use crate::cpu::march::{March, Steps};
use crate::cpu::simd::{Isa, Kernel, Run};
use crate::frame::RayStart;
use crate::model::Model;
use crate::picture::Render;
use crate::sh;
use crate::shade::{Shade, Span};

/// Rays of a wave: their samples, some 2 KB a ray, stay in the second cache.
const RAYS: usize = 256;
/// Samples a ray gets in a round: few are in vain behind its end.
const ROUND: usize = 8;
/// What weighs less at the end of a round waits for the next: half a step of 8 bits.
const FAINT: f32 = 1.0 / 512.0;

/// A ray on its way.
struct Walk {
    /// Its pixel in the strip, by rows.
    pixel: usize,
    tile: usize,
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

/// Memory of one worker, and its rays.
#[derive(Default)]
pub struct Wave {
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

impl Wave {
    /// Traces the rays of some pixels of a strip, in this order.
    ///
    /// A pixel without a ray stays black and empty.
    pub fn trace(&mut self, view: &Viewpoint, rays: &StripRays, pixels: &[u32], strip: &mut Render) {
        let walks = pixels.iter().filter_map(|pixel| {
            let start = rays.starts[*pixel as usize]?;
            Some((*pixel as usize, (pixel % strip.width / TILE) as usize, start))
        });
        let mut walks: Vec<_> = walks.collect();
        walks.reverse();
        loop {
            while self.walks.len() < RAYS
                && let Some((pixel, tile, start)) = walks.pop()
            {
                self.begin(pixel, tile, start);
            }
            if self.walks.is_empty() {
                return;
            }
            self.advance(view, &rays.steps);
            self.finish(view, &rays.steps, strip);
        }
    }

    /// Sets out a ray.
    fn begin(&mut self, pixel: usize, tile: usize, start: RayStart) {
        self.harmonics.push(sh::harmonics(start.direction));
        self.walks.push(Walk {
            pixel,
            tile,
            start,
            next_step: 0,
            optical_depth: 0.0,
            rgb: [0.0; 3],
            distance: 0.0,
            left: 1.0,
            faint: 0.0,
        });
    }

    /// Carries every ray over its next occupied samples.
    fn advance(&mut self, view: &Viewpoint, steps: &[Steps]) {
        let Viewpoint { level, model, .. } = *view;
        let shade = &mut self.shade;
        shade.samples.resize(0);
        self.spans.clear();
        for walk in &mut self.walks {
            let first = shade.samples.len();
            walk.next_step = level.run(March {
                clearance: None,
                steps: &steps[walk.tile],
                bits: &model.bits,
                origin: walk.start.origin,
                direction: walk.start.direction,
                jitter: MIDDLE,
                first: walk.next_step,
                limit: ROUND,
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
            accuracy: view.accuracy,
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
    fn finish(&mut self, view: &Viewpoint, steps: &[Steps], strip: &mut Render) {
        let mut going_on = 0;
        for index in 0..self.walks.len() {
            let walk = &self.walks[index];
            if walk.left >= view.accuracy.opaque && walk.next_step < steps[walk.tile].begin.len() {
                self.walks.swap(going_on, index);
                self.harmonics.swap(going_on, index);
                going_on += 1;
                continue;
            }
            walk.write(view.model, view.accuracy, &self.harmonics[index], strip);
        }
        self.walks.truncate(going_on);
        self.harmonics.truncate(going_on);
    }
}

/// Takes the densities of a round into the rays and chooses the samples whose colour counts. Spans then point
/// to these. Compiled for the instruction set, or each fused multiply-add is a call.
struct Weigh<'a> {
    accuracy: Accuracy,
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
        let (shade, accuracy) = (self.shade, self.accuracy);
        for (walk, span) in self.walks.iter_mut().zip(self.spans) {
            let first = self.kept.len();
            walk.optical_depth += shade.tau[span.first..span.end].iter().sum::<f32>();
            // The heaviest of the samples that are joined, and its weight.
            let mut heaviest = (span.first, 0.0);
            for index in span.first..span.end {
                let before = shade.transmittance[index];
                if before < accuracy.opaque {
                    walk.left = walk.left.min(before);
                    break;
                }
                let weight = before * shade.alpha[index];
                walk.distance = weight.mul_add(shade.samples.t[index], walk.distance);
                walk.left = before - weight;
                walk.faint += weight;
                if weight >= heaviest.1 {
                    heaviest = (index, weight);
                }
                if walk.faint >= accuracy.joined {
                    self.kept.push(heaviest.0 as u32);
                    self.weights.push(walk.faint);
                    (walk.faint, heaviest.1) = (0.0, 0.0);
                }
            }
            if walk.faint >= FAINT {
                self.kept.push(heaviest.0 as u32);
                self.weights.push(walk.faint);
                walk.faint = 0.0;
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
    /// Writes the pixel of a ray that is done.
    fn write(&self, model: &Model, accuracy: Accuracy, harmonics: &[f32; sh::COUNT], strip: &mut Render) {
        let met = (1.0 - self.left).clamp(0.0, 1.0);
        let rgb = if self.left < accuracy.opaque {
            // The weights of the colours add up to this.
            let coloured = met - self.faint;
            self.rgb.map(|channel| channel / coloured)
        } else {
            // What was too faint for a colour of its own takes the one behind it.
            let behind = model.weights.behind(model.config.background, harmonics);
            let through = self.left + self.faint;
            [0, 1, 2].map(|channel| through.mul_add(behind[channel], self.rgb[channel]))
        };
        let depth = self.distance / met * model.frame.half_side as f32;
        strip.rgb[self.pixel] = rgb;
        strip.opacity[self.pixel] = if self.left < accuracy.opaque { 1.0 } else { met };
        strip.depth[self.pixel] = if depth.is_finite() { depth } else { 0.0 };
    }
}
