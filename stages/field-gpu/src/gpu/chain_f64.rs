//! The loss of a batch in f64, for differences.

use super::chain_tests::visited;
use marf_field::cpu::composite::{OPAQUE, RAW_SHIFT};
use marf_field::cpu::net::Net;
use marf_field::cpu::simd::flat;
use marf_field::depth::{FLOOR, REACH};
use marf_field::draw::Target;
use marf_field::sh;
use marf_field::training::Training;

/// Layers as rows of weights `[inputs][outputs]`, with the number of outputs.
type Layers = Vec<(Vec<f64>, usize)>;

fn layers(net: &Net) -> Layers {
    let layer = |weights: &[f32], outputs: usize| (weights.iter().map(|x| f64::from(*x)).collect(), outputs);
    net.layers
        .iter()
        .map(|one| layer(flat(&one.weights), one.outputs))
        .collect()
}

fn forward(layers: &[(Vec<f64>, usize)], input: Vec<f64>) -> Vec<f64> {
    let last = layers.len() - 1;
    layers
        .iter()
        .enumerate()
        .fold(input, |input, (index, (weights, outputs))| {
            let mut sums = vec![0.0; *outputs];
            for (x, row) in input.iter().zip(weights.chunks(*outputs)) {
                sums.iter_mut()
                    .zip(row)
                    .for_each(|(sum, weight)| *sum += x * weight);
            }
            let open = |sum: f64| if index < last { sum.max(0.0) } else { sum };
            sums.into_iter().map(open).collect()
        })
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// The loss whose slopes the batch has, with one weight (tensor, place) moved by so much.
///
/// Tensors are the layers of the density network, then those of the colour network. Exposures are none, no raw
/// density and no logit is at its limit.
pub fn loss(training: &Training, targets: &[Target], tensor: usize, at: usize, by: f64) -> f64 {
    let (shade, spans) = visited(training, targets);
    let weights = &training.state.weights;
    let (mut density, mut color) = (layers(&weights.density), layers(&weights.color));
    let moved = density.iter_mut().chain(&mut color).nth(tensor);
    moved.unwrap().0[at] += by;
    let width = weights.row_blocks() * 16;
    let features = flat(&shade.features);
    let mut total = 0.0;
    for (target, span) in targets
        .iter()
        .zip(spans)
        .filter(|(target, _)| target.start.is_some())
    {
        let harmonics = sh::harmonics(target.start.unwrap().direction);
        let (mut left, mut rgb) = (1.0_f64, [0.0; 3]);
        let mut seen = Vec::new();
        for sample in span.first..span.end {
            if left < f64::from(OPAQUE) {
                break;
            }
            let input = features[sample * width..][..width].iter().map(|x| f64::from(*x));
            let mut latent = forward(&density, input.collect());
            let raw = latent[0];
            latent.extend(harmonics.map(f64::from));
            let logits = forward(&color, latent);
            let tau = (raw + f64::from(RAW_SHIFT)).exp() * f64::from(shade.samples.delta[sample]);
            let alpha = -(-tau).exp_m1();
            for channel in 0..3 {
                rgb[channel] += left * alpha * sigmoid(logits[channel]);
            }
            seen.push((left * alpha, alpha, f64::from(shade.samples.place[sample])));
            left *= (-tau).exp();
        }
        let background = weights
            .logits_behind(&harmonics)
            .map(|logit| sigmoid(f64::from(logit)));
        let own = target.behind;
        let behind = own.map_or(background, |own| own.rgb.map(f64::from));
        let passes = left - own.map_or(0.0, |own| f64::from(own.share));
        total += ray_loss(
            training,
            target,
            &seen,
            [0, 1, 2].map(|c| rgb[c] + passes * behind[c]),
            targets.len(),
        );
    }
    total
}

/// `seen`: weight, opacity and place of the samples.
fn ray_loss(
    training: &Training,
    target: &Target,
    seen: &[(f64, f64, f64)],
    rgb: [f64; 3],
    rays: usize,
) -> f64 {
    let cell = f64::from(1.0 / training.march.count as f32);
    let share = 1.0 / rays as f64;
    let squares: f64 = rgb
        .iter()
        .zip(target.rgb)
        .map(|(a, b)| (a - f64::from(b)).powi(2))
        .sum();
    let pairs = seen
        .iter()
        .flat_map(|a| seen.iter().map(move |b| a.0 * b.0 * (a.2 - b.2).abs()));
    let apart: f64 = pairs.sum::<f64>() + seen.iter().map(|a| a.0 * a.0 * cell / 3.0).sum::<f64>();
    let opacity: f64 = seen.iter().map(|a| a.1).sum();
    let pull = target.pull.map_or(0.0, |pull| {
        let near = |place: f64| (place - f64::from(pull.place)).abs() < f64::from(REACH) * cell;
        let there: f64 = if pull.place > 1.0 {
            1.0 - seen.iter().map(|a| a.0).sum::<f64>()
        } else {
            seen.iter().filter(|a| near(a.2)).map(|a| a.0).sum()
        };
        -f64::from(pull.weight) * (there + f64::from(FLOOR)).ln()
    });
    share
        * (squares / 3.0
            + f64::from(training.distortion_at(training.state.steps)) * apart
            + training.config.emptiness * opacity)
        + pull
}
