//! Adam over networks and background, and their average, against the CPU.

use marf_shaders::Pace;

use super::batch::BatchSize;
use super::nets::{Layers, Nets, Rates, Tensor};
use super::rig::{Rig, TOLERANCE, agree};
use super::testing::numbers;
use marf_field::cpu::adam::{Adam, Bias, Moments};
use marf_field::cpu::simd::{InstructionSet, Run};
use marf_field::schedule::{BACKGROUND_RATE, DECAY, EPSILON};

/// Rows of networks and background, and two beyond.
const ROWS: usize = 70;
/// First row of the background.
const BEHIND: usize = 64;

fn four_layers() -> Layers {
    Layers {
        shapes: vec![[16, 16]; 4],
        density: 2,
    }
}

const SIZE: BatchSize = BatchSize {
    samples: 256,
    rays: 64,
};

/// Takes three steps on the device. Returns weights, means, squares, gradients, averages and counts.
fn adam(
    rig: &Rig,
    weights: &[f32],
    gradients: &[Vec<f32>],
    count: &[u32],
    keep: f32,
) -> ([Vec<f32>; 5], Vec<u32>) {
    let nets = Nets::new(&rig.gpu, &four_layers()).unwrap();
    let bias = Nets::bias(&rig.gpu, &Bias::default()).unwrap();
    let pace = Pace {
        rate: 0.02,
        keep,
        ..Pace::default()
    };
    let pace = rig.gpu.uniform("pace", pace).unwrap();
    let zeros = [0.0; 16 * ROWS];
    let [w, g, m, v, a] = [weights, &gradients[0], &zeros, &zeros, &zeros].map(|x| rig.filled(x));
    let count = rig.gpu.filled("count", count).unwrap();
    let tensor = Tensor {
        weights: &w,
        gradient: &g,
        mean: &m,
        square: &v,
        count: &count,
        average: &a,
    };
    let rates = Rates {
        pace: &pace,
        bias: &bias,
    };
    let run = nets.adam(rig.batch(), rates, tensor).unwrap();
    for gradient in gradients {
        rig.gpu.write(&g, 0, gradient);
        rig.gpu.submit(|recorder| run.record(recorder));
    }
    let read = [&w, &m, &v, &g, &a].map(|array| rig.gpu.read(array).unwrap());
    (read, rig.gpu.read(&count).unwrap())
}

fn gradients() -> Vec<Vec<f32>> {
    let steps = (0..3).map(|step| {
        let mut gradient = numbers(16 * ROWS, 20 + step);
        // Rows without a gradient, of both zeros. One number alone, the sizes of a training, a huge one.
        gradient[..16].fill(0.0);
        gradient[16..32].fill(-0.0);
        gradient[32..47].fill(0.0);
        gradient[48..160].iter_mut().for_each(|x| *x *= 1e-7);
        gradient[160] = 1e25;
        gradient
    });
    steps.collect()
}

#[test]
fn adam_moves_weights_as_the_cpu_does_and_the_average_follows() {
    let test = "adam_moves_weights_as_the_cpu_does_and_the_average_follows";
    let Some(rig) = Rig::new(test, SIZE, [0; 3]) else {
        return;
    };
    let weights = numbers(16 * ROWS, 6);
    let mut counts = vec![0; ROWS];
    counts[4..8].copy_from_slice(&[1, 4094, 4095, u32::MAX]);
    let ([moved, mean, square, rest, average], count) = adam(&rig, &weights, &gradients(), &counts, 0.75);
    let (mut expected, mut moments) = (weights.clone(), Moments::new(16 * ROWS, 16));
    moments.count.copy_from_slice(&counts);
    // The last two rows are beyond what there is.
    let last = 16 * (BEHIND + 4);
    let mut followed = vec![0.0_f32; last];
    for gradient in gradients() {
        let mut before = expected.clone();
        for (rows, rate, decay) in [
            (0..BEHIND, 0.02, DECAY),
            (BEHIND..BEHIND + 4, 0.02 * BACKGROUND_RATE, 0.0),
        ] {
            let numbers = 16 * rows.start..16 * rows.end;
            let mut own = Moments {
                first: moments.first[numbers.clone()].to_vec(),
                second: moments.second[numbers.clone()].to_vec(),
                count: moments.count[rows.clone()].to_vec(),
            };
            InstructionSet::best().run(Adam::<16> {
                weights: &mut before[numbers.clone()],
                gradient: &mut gradient[numbers.clone()].to_vec(),
                moments: &mut own,
                rate,
                epsilon: EPSILON,
                decay,
                bias: &Bias::default(),
            });
            moments.first[numbers.clone()].copy_from_slice(&own.first);
            moments.second[numbers].copy_from_slice(&own.second);
            moments.count[rows].copy_from_slice(&own.count);
        }
        expected = before;
        let pairs = followed.iter_mut().zip(&expected);
        pairs.for_each(|(average, value)| *average += 0.25 * (value - *average));
    }
    agree("adam, weights", &moved, &expected, TOLERANCE);
    agree("adam, average", &average[..last], &followed, TOLERANCE);
    // The huge gradient's moments would hide all others.
    agree("adam, mean", &mean[176..], &moments.first[176..], TOLERANCE);
    agree("adam, square", &square[176..], &moments.second[176..], TOLERANCE);
    assert_eq!(count, moments.count);
    assert_eq!((&moved[..32], &moved[last..]), (&weights[..32], &weights[last..]));
    assert!(rest[..last].iter().all(|gradient| *gradient == 0.0));
    assert!(rest[last..].iter().chain(&moved[last..]).all(|x| *x != 0.0));
    assert!(average[last..].iter().all(|average| *average == 0.0));
}

#[test]
fn an_average_that_keeps_all_stays() {
    let Some(rig) = Rig::new("an_average_that_keeps_all_stays", SIZE, [0; 3]) else {
        return;
    };
    let mut weights = numbers(16 * ROWS, 6);
    weights[3] = f32::INFINITY;
    let ([.., average], _) = adam(&rig, &weights, &gradients(), &[0; ROWS], 1.0);
    assert!(average.iter().all(|average| *average == 0.0));
}

#[test]
fn adam_stands_still_once_anything_ran_away() {
    for fault in [0, 6] {
        let Some(rig) = Rig::new("adam_stands_still_once_anything_ran_away", SIZE, [0; 3]) else {
            return;
        };
        rig.gpu.write(&rig.faults, fault, &[1]);
        let weights = numbers(16 * ROWS, 6);
        let gradients = gradients();
        let ([moved, mean, _, rest, average], count) = adam(&rig, &weights, &gradients, &[0; ROWS], 0.5);
        assert_eq!(moved, weights);
        assert_eq!((mean[40], count[4], rest), (0.0, 0, gradients[2].clone()));
        assert!(average.iter().all(|average| *average == 0.0));
    }
}
