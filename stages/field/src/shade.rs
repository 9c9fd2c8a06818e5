//! What training and rendering share: samples to raw densities and opacities, kept samples to colours.

use crate::cpu::composite::{Colours, Depths, ExpNeg, OPAQUE};
use crate::cpu::encode::{Lookup, Points, Shape};
use crate::cpu::march::Samples;
use crate::cpu::simd::{Block, InstructionSet, LANES, Run, Stripe};
use crate::sh;
use crate::weights::Weights;

/// Memory for the samples of some rays; reused, never read before it is written.
#[derive(Default)]
pub struct Shade {
    /// The samples; padded to a multiple of 16 with samples of no length.
    pub samples: Samples,
    /// Encoded features, input of the density network.
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
        let width = weights.row_blocks();
        self.features.resize(self.samples.len() * width, Block::default());
        let stripes = Stripe::cut(&mut self.features, width, weights.features);
        let levels = weights.shapes.iter().zip(&weights.tables).zip(stripes);
        for ((shape, table), stripe) in levels {
            let points = self.samples.points();
            lookup(level, weights.features, *shape, table, points, stripe);
        }
        self.infer(level, weights);
    }

    /// Runs the density network on encoded samples.
    pub fn infer(&mut self, level: InstructionSet, weights: &Weights) {
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

    /// Drops samples behind a transmittance of [`OPAQUE`]; spans then point to what is left.
    pub fn drop_hidden(&mut self, spans: &mut [Span], kept: &mut Vec<u32>) {
        kept.clear();
        for span in spans {
            let first = kept.len();
            let visible = (span.first..span.end).take_while(|index| self.transmittance[*index] >= OPAQUE);
            kept.extend(visible.map(|index| index as u32));
            *span = Span {
                first,
                end: kept.len(),
            };
        }
        let before = self.raw.len();
        let padded = kept.len().next_multiple_of(LANES);
        self.samples.gather(kept);
        self.samples.resize(padded);
        for array in [
            &mut self.raw,
            &mut self.tau,
            &mut self.alpha,
            &mut self.transmittance,
        ] {
            for (to, from) in kept.iter().enumerate() {
                array[to] = array[*from as usize];
            }
            array.truncate(kept.len());
            array.resize(padded, 0.0);
        }
        for rows in std::iter::once(&mut self.features).chain(&mut self.density) {
            gather_rows(rows, rows.len() / before.max(1), kept, padded);
        }
    }

    /// Keeps the outputs of the density network of these samples, all that [`Self::colours`] needs.
    pub fn keep_latent(&mut self, kept: &[u32]) {
        let padded = kept.len().next_multiple_of(LANES);
        if let Some(latent) = self.density.last_mut() {
            gather_rows(latent, 1, kept, padded);
        }
        self.raw.resize(padded, 0.0);
    }

    /// Runs the colour network; `harmonics` are those of every ray's direction.
    pub fn colours(
        &mut self,
        level: InstructionSet,
        weights: &Weights,
        spans: &[Span],
        harmonics: &[[f32; sh::COUNT]],
    ) {
        let n = self.raw.len();
        let outputs = self.density.last().map_or(&[][..], Vec::as_slice);
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

/// Moves the kept rows of `width` blocks to the front and pads with zeros.
fn gather_rows(rows: &mut Vec<Block>, width: usize, kept: &[u32], padded: usize) {
    for (to, from) in kept
        .iter()
        .enumerate()
        .filter(|(to, from)| *to != **from as usize)
    {
        let from = *from as usize * width;
        rows.copy_within(from..from + width, to * width);
    }
    rows.truncate(kept.len() * width);
    rows.resize(padded * width, Block::default());
}
