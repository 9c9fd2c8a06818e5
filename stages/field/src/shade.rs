//! What training and rendering share: samples to raw densities and opacities, kept samples to colours.

use crate::cpu::composite::{Colours, Depths, ExpNeg, OPAQUE};
use crate::cpu::encode::{Lookup, Points, Shape};
use crate::cpu::march::Samples;
use crate::cpu::simd::{Block, InstructionSet, Isa, Kernel, LANES, Run, Stripe, flat, flat_mut};
use crate::sh;
use crate::weights::Weights;

/// Memory for the samples of some rays; reused, never read before it is written.
#[derive(Default)]
pub struct Shade {
    /// The samples; padded to a multiple of 16 with samples of no length.
    pub samples: Samples,
    /// Encoded features level by level, `[levels, n, F]`: what one lookup writes lies together.
    planes: Vec<Block>,
    /// The same sample by sample, `[n, levels F]`: input of the density network.
    pub features: Vec<Block>,
    /// Outputs of the density network's layers.
    pub density: Vec<Vec<Block>>,
    /// Raw densities.
    pub raw: Vec<f32>,
    /// Optical depths.
    pub tau: Vec<f32>,
    /// Opacities.
    pub alpha: Vec<f32>,
    /// Transmittances before the samples.
    pub transmittance: Vec<f32>,
    /// Input of the colour network.
    pub latent: Vec<Block>,
    /// Outputs of the colour network's layers.
    pub color: Vec<Vec<Block>>,
    /// Colours.
    pub rgb: Vec<[f32; 4]>,
    moves: Vec<Move>,
}

/// The samples of one ray among those of many.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Span {
    /// First sample.
    pub first: usize,
    /// One after the last.
    pub end: usize,
}

impl Shade {
    /// Encodes all samples and runs the density network.
    pub fn densities(&mut self, level: InstructionSet, weights: &Weights) {
        self.samples.resize(self.samples.len().next_multiple_of(LANES));
        let mut planes = std::mem::take(&mut self.planes);
        planes.resize(self.samples.len() * weights.row_blocks(), Block::default());
        let levels = weights.shapes.iter().zip(&weights.tables);
        for ((shape, table), plane) in levels.zip(planes_mut(&mut planes, weights)) {
            let to = Stripe::plane(plane, weights.features);
            lookup(level, weights.features, *shape, table, self.samples.points(), to);
        }
        self.infer(level, weights, &planes);
        self.planes = planes;
    }

    /// Runs the density network on encoded samples, `[levels, n, F]`.
    pub fn infer(&mut self, level: InstructionSet, weights: &Weights, planes: &[Block]) {
        self.features.resize(planes.len(), Block::default());
        level.run(ToRows {
            planes,
            rows: &mut self.features,
            features: weights.features,
            levels: weights.shapes.len(),
        });
        weights.density.forward(level, &self.features, &mut self.density);
        let latent = self.density.last().map_or(&[][..], Vec::as_slice);
        self.raw.clear();
        self.raw.extend(latent.iter().map(|row| row.0[0]));
    }

    /// Turns raw densities into optical depths and opacities, and these into transmittances along every ray.
    ///
    /// `before`: optical depth in front of the first sample of every ray.
    pub fn opacities(&mut self, level: InstructionSet, spans: &[Span], before: &[f32]) {
        let n = self.raw.len();
        for array in [&mut self.tau, &mut self.alpha, &mut self.transmittance] {
            array.resize(n, 0.0);
        }
        level.run(Depths {
            raw: &self.raw,
            delta: &self.samples.delta,
            tau: &mut self.tau,
            alpha: &mut self.alpha,
        });
        self.transmittance.fill(0.0);
        for (span, before) in spans.iter().zip(before) {
            let mut depth = *before;
            for index in span.first..span.end {
                self.transmittance[index] = depth;
                depth += self.tau[index];
            }
        }
        level.run(ExpNeg(&mut self.transmittance));
    }

    /// Drops samples behind a transmittance of [`OPAQUE`]; spans then point to what is left, `kept` tells where it was.
    pub fn drop_hidden(&mut self, spans: &mut [Span], kept: &mut Vec<u32>) {
        kept.clear();
        self.moves.clear();
        for span in spans {
            let along = &self.transmittance[span.first..span.end];
            let visible = along.iter().take_while(|left| **left >= OPAQUE).count();
            let to = kept.len();
            kept.extend((span.first..span.first + visible).map(|index| index as u32));
            self.moves.push(Move {
                from: span.first,
                to,
                len: visible,
            });
            *span = Span {
                first: to,
                end: to + visible,
            };
        }
        let (before, left) = (self.raw.len(), kept.len());
        let padded = left.next_multiple_of(LANES);
        let samples = self.samples.arrays();
        let numbers = [
            &mut self.raw,
            &mut self.tau,
            &mut self.alpha,
            &mut self.transmittance,
        ];
        for array in samples.into_iter().chain(numbers) {
            carry(array, 1, &self.moves);
            array.truncate(left);
            array.resize(padded, 0.0);
        }
        for rows in std::iter::once(&mut self.features).chain(&mut self.density) {
            let width = rows.len() / before.max(1);
            carry(rows, width, &self.moves);
            rows.truncate(left * width);
            rows.resize(padded * width, Block::default());
        }
    }

    /// Keeps the outputs of the density network of these samples, all that [`Self::colours`] needs.
    pub fn keep_latent(&mut self, kept: &[u32]) {
        if let Some(latent) = self.density.last_mut() {
            for (to, from) in kept.iter().enumerate() {
                latent[to] = latent[*from as usize];
            }
            latent.truncate(kept.len());
            latent.resize(kept.len().next_multiple_of(LANES), Block::default());
        }
    }

    /// Runs the colour network; `harmonics` are those of every ray's direction.
    pub fn colours(
        &mut self,
        level: InstructionSet,
        weights: &Weights,
        spans: &[Span],
        harmonics: &[[f32; sh::COUNT]],
    ) {
        let outputs = self.density.last().map_or(&[][..], Vec::as_slice);
        let n = outputs.len();
        let blocks = weights.color_blocks();
        self.latent.resize(blocks * n, Block::default());
        for (row, output) in self.latent.chunks_exact_mut(blocks).zip(outputs) {
            row[0] = *output;
        }
        if blocks > 1 {
            for (span, harmonics) in spans.iter().zip(harmonics) {
                for index in span.first..span.end {
                    self.latent[blocks * index + 1].0 = *harmonics;
                }
            }
        }
        weights.color.forward(level, &self.latent, &mut self.color);
        self.rgb.resize(n, [0.0; 4]);
        let logits = self.color.last().map_or(&[][..], Vec::as_slice);
        level.run(Colours {
            logits,
            rgb: &mut self.rgb,
        });
    }
}

/// Looks up one level for all points.
pub fn lookup(
    level: InstructionSet,
    features: usize,
    shape: Shape,
    table: &[f32],
    points: Points,
    to: Stripe,
) {
    match features {
        2 => level.run(Lookup::<2> {
            shape,
            table,
            points,
            to,
        }),
        _ => level.run(Lookup::<4> {
            shape,
            table,
            points,
            to,
        }),
    }
}

/// Samples of a ray that move forward together.
#[derive(Clone, Copy, Debug)]
struct Move {
    from: usize,
    to: usize,
    len: usize,
}

/// Moves samples of `width` elements each; none moves backward, none onto one that has yet to move.
fn carry<T: Copy>(elements: &mut [T], width: usize, moves: &[Move]) {
    for Move { from, to, len } in moves.iter().filter(|part| part.from != part.to) {
        elements.copy_within(from * width..(from + len) * width, to * width);
    }
}

/// Cuts `[levels, n, F]` into its levels.
pub fn planes_mut<'a>(planes: &'a mut [Block], weights: &Weights) -> impl Iterator<Item = &'a mut [Block]> {
    let plane = planes.len() / weights.shapes.len().max(1);
    planes.chunks_mut(plane.max(1))
}

/// From `[levels, n, F]` to `[n, levels F]`, n a multiple of 16.
struct ToRows<'a> {
    planes: &'a [Block],
    rows: &'a mut [Block],
    features: usize,
    levels: usize,
}

impl Kernel for ToRows<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        let (planes, rows) = (flat(self.planes), flat_mut(self.rows));
        match self.features {
            2 => transpose::<2>(planes.as_chunks().0, rows.as_chunks_mut().0, self.levels),
            _ => transpose::<4>(planes.as_chunks().0, rows.as_chunks_mut().0, self.levels),
        }
    }
}

/// From `[n, levels F]` to `[levels, n, F]`, n a multiple of 16.
pub struct ToPlanes<'a> {
    /// Row by row.
    pub rows: &'a [Block],
    /// Level by level.
    pub planes: &'a mut [Block],
    /// F.
    pub features: usize,
    /// Levels.
    pub levels: usize,
}

impl Kernel for ToPlanes<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        let (rows, planes) = (flat(self.rows), flat_mut(self.planes));
        let samples = rows.len() / (self.features * self.levels).max(1);
        match self.features {
            2 => transpose::<2>(rows.as_chunks().0, planes.as_chunks_mut().0, samples),
            _ => transpose::<4>(rows.as_chunks().0, planes.as_chunks_mut().0, samples),
        }
    }
}

/// Transposes a matrix of `rows` rows of entries of F numbers, 16 columns at a time: these stay in the first cache.
#[inline(always)]
fn transpose<const F: usize>(from: &[[f32; F]], to: &mut [[f32; F]], rows: usize) {
    let columns = from.len() / rows.max(1);
    for (block, to) in to.chunks_mut((LANES * rows).max(1)).enumerate() {
        for row in 0..rows {
            let from = &from[row * columns + block * LANES..];
            for (to, from) in to.chunks_exact_mut(rows).zip(from) {
                to[row] = *from;
            }
        }
    }
}
