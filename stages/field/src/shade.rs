//! What training and rendering share: samples to raw densities and opacities, kept samples to colours.

use crate::cpu::composite::{Colours, Depths, ExpNeg, OPAQUE};
use crate::cpu::march::Samples;
use crate::cpu::simd::{Block, InstructionSet, LANES, Run, Stripe};
use crate::planes::{GridLevel, ToRows, planes_mut};
use crate::sh;
use crate::weights::Weights;

/// Part of the samples that are trained which are spread evenly over those that show, whatever they weigh: what is thin now may
/// have to grow. `benches/field.md`.
pub const EVEN: f32 = 0.02;

/// Memory for the samples of some rays. It is reused, and never read before it is written.
#[derive(Clone, Default)]
pub struct Shade {
    /// The samples, padded to a multiple of 16 with samples of no length.
    pub samples: Samples,
    /// Encoded features level by level, `[levels, n, F]`: one lookup writes adjacent numbers.
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
            let grid = GridLevel::new(weights.features, *shape, table);
            grid.lookup(level, self.samples.points(), to);
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

    /// Lists the samples to train on: about `most` of every ray, see [`Self::thin`], or all that show where it is 0.
    pub fn choose(&mut self, most: u32, spans: &[Span], kept: &mut Vec<u32>) {
        match most {
            0 => self.list_shown(spans, kept),
            _ => self.thin(spans, most, kept),
        }
    }

    /// Lists the samples of every ray in front of a transmittance of [`OPAQUE`].
    fn list_shown(&self, spans: &[Span], kept: &mut Vec<u32>) {
        kept.clear();
        for span in spans {
            kept.extend((span.first..span.first + self.shown(*span)).map(|index| index as u32));
        }
    }

    /// Lists about `most` of the samples of every ray that show, chosen by weight. Each represents those that
    /// it was chosen from: its length is divided by the share p with which it is chosen.
    ///
    /// p = min(1, `most` (w + [`EVEN`] / n)), w the weight and n the samples of the ray that show: in the mean over all draws the
    /// optical depth along the ray stays what it is. One draw a ray ([`draw`]) chooses all of its samples (systematic
    /// sampling: Madow 1949, Ann. Math. Stat. 20, 333), so that their number differs from the sum of the shares by less than 1.
    ///
    /// # Extremes
    /// A ray of at most `most` [`EVEN`] samples keeps all that show. Lengths stay finite: p is at least `most` [`EVEN`] / n.
    fn thin(&mut self, spans: &[Span], most: u32, kept: &mut Vec<u32>) {
        kept.clear();
        for span in spans {
            let shown = self.shown(*span);
            let even = EVEN / shown.max(1) as f32;
            let mut sum = self.samples.t.get(span.first).map_or(0.0, |t| draw(*t));
            for index in span.first..span.first + shown {
                let weight = self.transmittance[index] * self.alpha[index];
                let share = (most as f32 * (weight + even)).min(1.0);
                let next = sum + share;
                if next.floor() > sum.floor() {
                    self.samples.delta[index] /= share;
                    kept.push(index as u32);
                }
                sum = next;
            }
        }
    }

    /// Returns how many samples of a ray show.
    fn shown(&self, span: Span) -> usize {
        let along = &self.transmittance[span.first..span.end];
        along.iter().take_while(|left| **left >= OPAQUE).count()
    }

    /// Keeps these samples, in their order. Spans then point to the kept samples.
    pub fn keep(&mut self, spans: &mut [Span], kept: &[u32]) {
        let mut to = 0;
        for span in spans {
            let first = to;
            to += kept[to..]
                .iter()
                .take_while(|from| (**from as usize) < span.end)
                .count();
            *span = Span { first, end: to };
        }
        let before = self.raw.len();
        let padded = kept.len().next_multiple_of(LANES);
        let samples = self.samples.arrays();
        let numbers = [
            &mut self.raw,
            &mut self.tau,
            &mut self.alpha,
            &mut self.transmittance,
        ];
        for array in samples.into_iter().chain(numbers) {
            gather(array, 1, kept);
            array.truncate(kept.len());
            array.resize(padded, 0.0);
        }
        for rows in std::iter::once(&mut self.features).chain(&mut self.density) {
            let width = rows.len() / before.max(1);
            gather(rows, width, kept);
            rows.truncate(kept.len() * width);
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

    /// Runs the colour network. `harmonics` are those of every ray's direction.
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

/// Moves samples of `width` elements each to the front. `kept` lists their indices in rising order.
fn gather<T: Copy>(elements: &mut [T], width: usize, kept: &[u32]) {
    for (to, from) in kept
        .iter()
        .enumerate()
        .filter(|(to, from)| *to != **from as usize)
    {
        for element in 0..width {
            elements[to * width + element] = elements[*from as usize * width + element];
        }
    }
}

/// Returns a number in [0, 1) unrelated to anything on the ray, from the bits of the distance of its first
/// sample (lowbias32 of Wellons 2018). It is the same on every device.
fn draw(t: f32) -> f32 {
    let mut bits = t.to_bits();
    bits = (bits ^ bits >> 16).wrapping_mul(0x7feb_352d);
    bits = (bits ^ bits >> 15).wrapping_mul(0x846c_a68b);
    ((bits ^ bits >> 16) >> 8) as f32 / (1 << 24) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ray of these samples in one span. `t` is the distance of the first.
    fn ray(raw: &[f32], t: f32) -> (Shade, [Span; 1]) {
        let mut shade = Shade {
            raw: raw.to_vec(),
            ..Shade::default()
        };
        shade.samples.resize(raw.len());
        shade.samples.t.fill(t);
        shade.samples.delta.fill(0.02);
        let spans = [Span {
            first: 0,
            end: raw.len(),
        }];
        shade.opacities(InstructionSet::best(), &spans, &[0.0]);
        (shade, spans)
    }

    /// Fog, a surface, and matter behind it.
    fn scene() -> Vec<f32> {
        let fog = std::iter::repeat_n(-1.0, 60);
        fog.chain([3.0, 5.0, 7.0, 8.0, 8.0, 8.0])
            .chain([1.0; 10])
            .collect()
    }

    fn shares(shade: &Shade, most: f32, shown: usize) -> Vec<f32> {
        let weights = shade.transmittance.iter().zip(&shade.alpha).take(shown);
        let even = EVEN / shown as f32;
        weights
            .map(|(left, alpha)| (most * (left * alpha + even)).min(1.0))
            .collect()
    }

    #[test]
    fn samples_are_kept_as_often_as_they_weigh_and_their_lengths_keep_their_mean() {
        const DRAWS: usize = 4096;
        let raw = scene();
        let mut lengths = vec![0.0_f64; raw.len()];
        let mut expected = Vec::new();
        for number in 0..DRAWS {
            let (mut shade, spans) = ray(&raw, 1.0 + number as f32 / DRAWS as f32);
            let (mut kept, shown) = (Vec::new(), shade.shown(spans[0]));
            assert!(shown > 62 && shown < raw.len(), "{shown} show");
            expected = shares(&shade, 8.0, shown);
            shade.thin(&spans, 8, &mut kept);
            let sum: f32 = expected.iter().sum();
            assert!((kept.len() as f32 - sum).abs() < 1.0, "{} of {sum}", kept.len());
            for index in &kept {
                let index = *index as usize;
                let length = shade.samples.delta[index];
                assert!((length * expected[index] / 0.02 - 1.0).abs() < 1e-6, "{index}");
                lengths[index] += f64::from(length) / DRAWS as f64;
            }
        }
        for (index, share) in expected.iter().enumerate() {
            // Five standard deviations of the mean of independent draws.
            let scatter = 5.0 * (f64::from(1.0 / share - 1.0) / DRAWS as f64).sqrt();
            let mean = lengths[index] / 0.02;
            assert!((mean - 1.0).abs() <= scatter + 1e-6, "{index}: {mean}, {scatter}");
        }
    }

    #[test]
    fn a_ray_whose_samples_all_weigh_enough_keeps_them_as_they_are() {
        for (raw, most) in [
            (vec![3.0, 4.0, 3.0], 4096),
            (vec![-30.0; 40], 4096),
            (vec![1e9], 1),
            (Vec::new(), 1),
        ] {
            let (mut shade, spans) = ray(&raw, 0.5);
            let lengths = shade.samples.delta.clone();
            let (mut all, mut kept) = (Vec::new(), Vec::new());
            shade.list_shown(&spans, &mut all);
            shade.thin(&spans, most, &mut kept);
            assert_eq!((kept, shade.samples.delta), (all, lengths), "{raw:?}");
        }
    }

    #[test]
    fn ends_of_densities_and_of_rays_give_finite_lengths() {
        let raw: Vec<f32> = (0..10_000).map(|at| [-1e9, -30.0, -9.0][at % 3]).collect();
        let (mut shade, spans) = ray(&raw, f32::MAX);
        let mut kept = Vec::new();
        shade.thin(&spans, 1, &mut kept);
        assert!(kept.len() <= 1);
        let (mut shade, spans) = ray(&raw, 0.0);
        shade.thin(&spans, 4096, &mut kept);
        assert!(
            kept.is_sorted() && (81..=83).contains(&kept.len()),
            "{}",
            kept.len()
        );
        assert!(
            shade
                .samples
                .delta
                .iter()
                .all(|length| *length > 0.0 && *length < 3.0)
        );
    }

    #[test]
    fn what_is_kept_moves_to_the_front_with_all_its_numbers() {
        let (mut shade, _) = ray(&[0.5; 20], 1.0);
        shade.raw = (0..20).map(|at| at as f32).collect();
        let block = |at: usize| Block([at as f32; LANES]);
        shade.features = (0..40).map(block).collect();
        shade.density = vec![(0..20).map(block).collect()];
        let mut spans = [[0, 4], [4, 4], [4, 20]].map(|[first, end]| Span { first, end });
        shade.keep(&mut spans, &[1, 3, 4, 17]);
        assert_eq!(
            spans,
            [[0, 2], [2, 2], [2, 4]].map(|[first, end]| Span { first, end })
        );
        assert_eq!(shade.raw, [[1.0, 3.0, 4.0, 17.0].as_slice(), &[0.0; 12]].concat());
        let rows: Vec<f32> = shade.features.iter().take(9).map(|row| row.0[15]).collect();
        assert_eq!(rows, [2.0, 3.0, 6.0, 7.0, 8.0, 9.0, 34.0, 35.0, 0.0]);
        assert_eq!(shade.density[0].len(), 16);
        assert_eq!(shade.density[0][3], block(17));
        assert_eq!(shade.samples.len(), 16);
    }
}
