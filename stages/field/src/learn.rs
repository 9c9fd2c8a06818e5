//! From the gradients of all chunks to new weights, in an order that no thread can change.

use rayon::prelude::*;

use crate::Gain;
use crate::batch::Chunk;
use crate::cpu::adam::{Adam, Bias, Moments};
use crate::cpu::encode::{Scatter, Shape, warm};
use crate::cpu::simd::{InstructionSet, LANES, Run, flat};
use crate::exposure::{LIMITS, RATE, ROW, centre};
use crate::schedule::{BACKGROUND_RATE, DECAY, EPSILON};
use crate::state::State;
use crate::training::Training;
use crate::weights::NET_ROW;

/// Applies the gradients of all chunks to the weights. `gradients`: memory for those of the tables, all zero.
pub fn learn(level: InstructionSet, training: &mut Training, gradients: &mut [Vec<f32>], chunks: &[Chunk]) {
    learn_tables(level, training, gradients, chunks);
    learn_networks(level, training, chunks);
    if training.config.gain != Gain::Off {
        let rate = training.rate_at(training.state.steps);
        learn_exposures(level, training, chunks, rate);
    }
}

/// How Adam moves weights.
#[derive(Clone, Copy)]
struct Rates<'a> {
    /// Step size.
    rate: f32,
    /// Pull to zero.
    decay: f32,
    /// Corrections of the moments.
    bias: &'a Bias,
}

/// Moves the tables: one task owns one level, adds all samples in order, then takes the step.
fn learn_tables(
    level: InstructionSet,
    training: &mut Training,
    gradients: &mut [Vec<f32>],
    chunks: &[Chunk],
) {
    let steps = training.state.steps;
    let keep = training.kept_at(steps);
    let rates = Rates {
        rate: training.rate_at(steps),
        decay: training.table_decay_at(steps),
        bias: &training.bias,
    };
    let State {
        weights,
        average,
        moments,
        ..
    } = &mut training.state;
    let features = weights.features;
    let shapes = weights.shapes.par_iter();
    let tables = weights.tables.par_iter_mut().zip(&mut average.tables);
    let tasks = shapes
        .zip(tables)
        .zip(gradients)
        .zip(moments)
        .enumerate()
        .with_max_len(1);
    tasks.for_each(|(index, (((shape, (table, average)), gradient), moments))| {
        warm(gradient);
        for chunk in chunks {
            scatter(level, *shape, gradient, chunk, index);
        }
        match features {
            2 => adam::<2>(level, table, gradient, moments, rates),
            _ => adam::<4>(level, table, gradient, moments, rates),
        }
        blend(average, table, keep);
    });
}

/// Adds the gradients of the networks and of the background in the order of the chunks, then moves them.
fn learn_networks(level: InstructionSet, training: &mut Training, chunks: &[Chunk]) {
    let steps = training.state.steps;
    let (rate, keep) = (training.rate_at(steps), training.kept_at(steps));
    let bias = &training.bias;
    let State {
        weights,
        average,
        moments,
        ..
    } = &mut training.state;
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
        let (rate, decay) = match name.as_str() {
            "background" => (rate * BACKGROUND_RATE, 0.0),
            _ => (rate, DECAY),
        };
        let rates = Rates { rate, decay, bias };
        adam::<NET_ROW>(level, values, &mut gradient, moments, rates);
        blend(average, values, keep);
    }
    weights.refresh();
    average.refresh();
}

/// Moves log gains and offsets and takes their means away: the scene keeps its own brightness.
pub fn learn_exposures(level: InstructionSet, training: &mut Training, chunks: &[Chunk], rate: f32) {
    let state = &mut training.state;
    let half = training.views.len() * ROW;
    let mut gradient = vec![0.0; state.gains.len()];
    for (view, slopes) in chunks.iter().flat_map(|chunk| &chunk.found.exposures) {
        let first = *view as usize * ROW;
        add(&mut gradient[first..], slopes.gain);
        if let Some(offsets) = gradient.get_mut(half + first..) {
            add(offsets, slopes.offset);
        }
    }
    let (numbers, moments) = (&mut state.gains, &mut state.gain_moments);
    let rates = Rates {
        rate: rate * RATE,
        decay: 0.0,
        bias: &training.bias,
    };
    adam::<ROW>(level, numbers, &mut gradient, moments, rates);
    for (numbers, limit) in numbers.chunks_mut(half).zip(LIMITS) {
        centre(numbers, limit);
    }
}

/// Adds three channels where there is a row to take them.
fn add(row: &mut [f32], slopes: [f32; 3]) {
    for (sum, slope) in row.iter_mut().zip(slopes) {
        *sum += slope;
    }
}

/// Adds the gradients of a chunk's features to those of the table `index`.
fn scatter(level: InstructionSet, shape: Shape, gradient: &mut [f32], chunk: &Chunk, index: usize) {
    let features = gradient.len() / shape.entries as usize;
    let (points, first) = (chunk.samples.points(), 0);
    let plane = chunk.samples.len() * features / LANES;
    let rows = &chunk.features[index * plane..][..plane];
    let stride = features;
    match features {
        2 => level.run(Scatter::<2> {
            shape,
            gradient,
            points,
            rows,
            stride,
            first,
        }),
        _ => level.run(Scatter::<4> {
            shape,
            gradient,
            points,
            rows,
            stride,
            first,
        }),
    }
}

/// Takes one step of Adam.
fn adam<const F: usize>(
    level: InstructionSet,
    weights: &mut [f32],
    gradient: &mut [f32],
    moments: &mut Moments,
    rates: Rates<'_>,
) {
    level.run(Adam::<F> {
        weights,
        gradient,
        moments,
        rate: rates.rate,
        epsilon: EPSILON,
        decay: rates.decay,
        bias: rates.bias,
    });
}

/// Moves a running average: average = keep average + (1 - keep) values, where it is due.
pub fn blend(average: &mut [f32], values: &[f32], keep: Option<f32>) {
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
