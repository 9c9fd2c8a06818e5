//! From the gradients of all chunks to new weights, in an order that no thread can change.

use rayon::prelude::*;

use crate::batch::Chunk;
use crate::cpu::adam::{Adam, Bias, Moments};
use crate::cpu::encode::{Scatter, Shape};
use crate::cpu::simd::{Level, flat};
use crate::trainer::State;
use crate::weights::NET_ROW;
use crate::{Gain, Trainer};

/// Adam's epsilon: gradients of a mean over the batch are about 1e-6, rounding noise is below 1e-12.
pub(crate) const EPSILON: f32 = 1e-12;
/// Pull of the networks' weights to zero (instant-ngp's l2).
pub(crate) const DECAY: f32 = 1e-6;
/// Steps between two looks of the averaged weights at the weights: every step costs a pass over all tables.
const AVERAGED_EVERY: u64 = 4;
/// Step size of the background, in learning rates: its 16 coefficients a channel have no layer to multiply them.
pub(crate) const BACKGROUND_RATE: f32 = 10.0;

impl Trainer {
    /// Takes the gradients of all chunks into the weights.
    pub(crate) fn learn(&mut self, chunks: &[Chunk]) {
        let (rate, keep) = (self.rate_at(self.state.steps), self.kept_at(self.state.steps));
        self.learn_tables(chunks, rate, keep);
        self.learn_networks(chunks, rate, keep);
        if self.config.gain != Gain::Off {
            self.learn_exposures(chunks, rate);
        }
    }

    /// Returns the step size after so many steps.
    pub(crate) fn rate_at(&self, steps: u64) -> f32 {
        let slowed = 1.0 + 3.0 * steps as f64 / f64::from(self.config.half_rate_steps);
        (self.config.learning_rate / slowed.sqrt()) as f32
    }

    /// Returns the share of themselves that the averaged weights keep after so many steps, less in the first ones.
    pub(crate) fn kept_at(&self, steps: u64) -> Option<f32> {
        let step = steps as f32;
        let once = (self.config.average as f32).min((1.0 + step) / (10.0 + step));
        let steps = steps + 1;
        if steps < 4 * AVERAGED_EVERY {
            return Some(once);
        }
        let is_due = steps.is_multiple_of(AVERAGED_EVERY);
        is_due.then(|| (0..AVERAGED_EVERY).fold(1.0, |product, _| product * once))
    }

    /// One task owns one level: it adds all samples in order, then moves the table.
    fn learn_tables(&mut self, chunks: &[Chunk], rate: f32, keep: Option<f32>) {
        let (level, bias) = (self.level, &self.bias);
        let State {
            weights,
            average,
            moments,
            ..
        } = &mut self.state;
        let features = weights.features;
        let width = weights.row_blocks();
        let shapes = weights.shapes.par_iter();
        let tables = weights.tables.par_iter_mut().zip(&mut average.tables);
        let tasks = shapes
            .zip(tables)
            .zip(&mut self.gradients)
            .zip(moments)
            .enumerate()
            .with_max_len(1);
        tasks.for_each(|(index, (((shape, (table, average)), gradient), moments))| {
            for chunk in chunks {
                let columns = [features, index * features, width];
                scatter(level, *shape, gradient, chunk, columns);
            }
            match features {
                2 => adam::<2>(level, table, gradient, moments, [rate, 0.0], bias),
                _ => adam::<4>(level, table, gradient, moments, [rate, 0.0], bias),
            }
            blend(average, table, keep);
        });
    }

    fn learn_networks(&mut self, chunks: &[Chunk], rate: f32, keep: Option<f32>) {
        let State {
            weights,
            average,
            moments,
            ..
        } = &mut self.state;
        let tables = weights.tables.len();
        let found = || chunks.iter().map(|chunk| &chunk.found);
        let mut sums: Vec<Vec<f32>> = Vec::new();
        for layer in 0..weights.density.layers.len() {
            sums.push(summed(found().map(|found| flat(&found.density[layer]))));
        }
        for layer in 0..weights.color.layers.len() {
            sums.push(summed(found().map(|found| flat(&found.color[layer]))));
        }
        sums.push(summed(found().map(|found| found.background.as_slice())));
        let tensors = weights
            .tensors_mut()
            .into_iter()
            .zip(average.tensors_mut())
            .skip(tables);
        for ((((name, values), (_, average)), moments), mut gradient) in
            tensors.zip(moments.iter_mut().skip(tables)).zip(sums)
        {
            let rates = match name.as_str() {
                "background" => [rate * BACKGROUND_RATE, 0.0],
                _ => [rate, DECAY],
            };
            adam::<NET_ROW>(self.level, values, &mut gradient, moments, rates, &self.bias);
            blend(average, values, keep);
        }
        weights.refresh();
        average.refresh();
    }
}

/// `[features, first, width]`: features an entry, the level's first in the row, blocks a row.
fn scatter(
    level: Level,
    shape: Shape,
    gradient: &mut [f32],
    chunk: &Chunk,
    [features, first, width]: [usize; 3],
) {
    let (points, rows) = (chunk.samples.points(), chunk.features.as_slice());
    match features {
        2 => level.run(Scatter::<2> {
            shape,
            gradient,
            points,
            rows,
            width,
            first,
        }),
        _ => level.run(Scatter::<4> {
            shape,
            gradient,
            points,
            rows,
            width,
            first,
        }),
    }
}

/// `rates`: step size and pull to zero.
pub(crate) fn adam<const F: usize>(
    level: Level,
    weights: &mut [f32],
    gradient: &mut [f32],
    moments: &mut Moments,
    rates: [f32; 2],
    bias: &Bias,
) {
    level.run(Adam::<F> {
        weights,
        gradient,
        moments,
        rate: rates[0],
        epsilon: EPSILON,
        decay: rates[1],
        bias,
    });
}

/// average = keep average + (1 - keep) values, where it is due.
pub(crate) fn blend(average: &mut [f32], values: &[f32], keep: Option<f32>) {
    let Some(keep) = keep else {
        return;
    };
    for (average, value) in average.iter_mut().zip(values) {
        *average += (1.0 - keep) * (*value - *average);
    }
}

/// Sums arrays of one length in order.
fn summed<'a>(mut parts: impl Iterator<Item = &'a [f32]>) -> Vec<f32> {
    let mut sum = parts.next().unwrap_or_default().to_vec();
    for part in parts {
        for (sum, value) in sum.iter_mut().zip(part) {
            *sum += *value;
        }
    }
    sum
}
