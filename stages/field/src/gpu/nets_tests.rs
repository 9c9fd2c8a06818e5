//! Layers against their twins on the CPU.

use marf_shaders::{Pace, counts, faults};

use super::nets::{After, CHUNK, Gradient, Nets, Product, Rates, Rows, Tensor};
use super::rig::{Rig, TOLERANCE, UNTOUCHED, agree, blocks, columns, is_untouched};
use super::testing::numbers;
use crate::cpu::adam::{Adam, Bias, Moments};
use crate::cpu::gemm;
use crate::cpu::simd::{Block, InstructionSet, LANES, Run, flat};
use crate::schedule::{DECAY, EPSILON};

const SHAPES: [[usize; 2]; 5] = [[32, 64], [64, 16], [16, 16], [32, 32], [16, 128]];

#[test]
fn products_are_those_of_the_cpu_and_write_nothing_else() {
    let (n, capacity) = (301, 512);
    let test = "products_are_those_of_the_cpu_and_write_nothing_else";
    let Some(rig) = Rig::new(test, [capacity, 64], [0, n as u32, 0]) else {
        return;
    };
    let nets = Nets::new(&rig.gpu).unwrap();
    for [inner, outputs] in SHAPES {
        let (a, b) = (numbers(304 * inner, 1), numbers(inner * outputs, 2));
        let gate = numbers(304 * outputs, 3);
        let open = blocks(&gate);
        let pairs = [gemm::After::Nothing, gemm::After::Relu, gemm::After::Gate(&open)];
        for (index, after) in pairs.into_iter().enumerate() {
            let mut expected = vec![Block::ZERO; 304 * outputs / LANES];
            InstructionSet::best().run(gemm::Product {
                a: &blocks(&a),
                b: &blocks(&b),
                c: &mut expected,
                inner,
                columns: outputs / LANES,
                after,
            });
            // One row lies before A, two before C.
            let mut left = vec![9.0; capacity];
            left.extend(columns(&a, inner, capacity, f32::NAN));
            let (left, right) = (rig.filled(&left), rig.filled(&b));
            let gate = rig.filled(&columns(&gate, outputs, capacity, 1.0));
            let found = rig.untouched(outputs + 3);
            let product = Product {
                a: Rows {
                    part: (&left).into(),
                    first: 1,
                },
                b: (&right).into(),
                c: Rows {
                    part: (&found).into(),
                    first: 2,
                },
                shape: [inner, outputs],
                after: [After::Nothing, After::Relu, After::Gate((&gate).into())][index].clone(),
            };
            let run = nets.product(rig.batch(), counts::KEPT, product).unwrap();
            rig.gpu.submit(|recorder| run.record(recorder));
            let found = rig.gpu.read(&found).unwrap();
            let expected = columns(flat(&expected), outputs, capacity, UNTOUCHED);
            let rows = found[2 * capacity..]
                .chunks(capacity)
                .zip(expected.chunks(capacity));
            let (here, there): (Vec<_>, Vec<_>) =
                rows.map(|(found, wanted)| (&found[..n], &wanted[..n])).unzip();
            let name = format!("product {inner} x {outputs}, {index}");
            agree(&name, &here.concat(), &there.concat()[..], TOLERANCE);
            let around = [&found[..2 * capacity], &found[(outputs + 2) * capacity..]].concat();
            assert!(around.iter().all(is_untouched), "{name}");
            let mut behind = found.chunks(capacity).flat_map(|row| &row[304..]);
            assert!(behind.all(is_untouched), "{name}");
        }
    }
}

#[test]
fn a_relu_passes_nan_on_and_a_gate_of_nan_is_shut() {
    let test = "a_relu_passes_nan_on_and_a_gate_of_nan_is_shut";
    let Some(rig) = Rig::new(test, [256, 64], [0, 8, 0]) else {
        return;
    };
    let nets = Nets::new(&rig.gpu).unwrap();
    let (mut a, mut gate) = (vec![1.0; 16 * 256], vec![1.0; 16 * 256]);
    a[1] = f32::NAN;
    a[2] = f32::INFINITY;
    gate[3] = f32::NAN;
    let (a, gate, b) = (rig.filled(&a), rig.filled(&gate), rig.filled(&[0.5; 256]));
    let found = [After::Relu, After::Gate((&gate).into())].map(|after| {
        let found = rig.untouched(16);
        let product = Product {
            a: (&a).into(),
            b: (&b).into(),
            c: (&found).into(),
            shape: [16, 16],
            after,
        };
        let run = nets.product(rig.batch(), counts::KEPT, product).unwrap();
        rig.gpu.submit(|recorder| run.record(recorder));
        rig.gpu.read(&found).unwrap()
    });
    assert!(
        found[0][1].is_nan() && found[0][2] == f32::INFINITY,
        "{:?}",
        &found[0][..4]
    );
    assert_eq!((found[0][0], found[1][0], found[1][3]), (8.0, 8.0, 0.0));
}

#[test]
fn transposed_weights_are_the_weights_turned() {
    let Some(rig) = Rig::new("transposed_weights_are_the_weights_turned", [256, 64], [0; 3]) else {
        return;
    };
    let nets = Nets::new(&rig.gpu).unwrap();
    let weights = numbers(32 * 48, 1);
    let (from, to) = (rig.filled(&weights), rig.filled(&vec![UNTOUCHED; 32 * 48 + 1]));
    let run = nets
        .transpose(&rig.gpu, [32, 48], (&from).into(), (&to).into())
        .unwrap();
    rig.gpu.submit(|recorder| run.record(recorder));
    let found = rig.gpu.read(&to).unwrap();
    assert_eq!(found[..32 * 48], columns(&weights, 48, 32, UNTOUCHED));
    assert_eq!(found[32 * 48], UNTOUCHED);
}

/// The gradient of `n` samples, and the array of parts.
fn gradient(rig: &Rig, [a, d]: [&[f32]; 2], shape: [usize; 2]) -> [Vec<f32>; 2] {
    let nets = Nets::new(&rig.gpu).unwrap();
    let [inner, outputs] = shape;
    // Garbage lies behind the samples in use.
    let a = rig.filled(&columns(a, inner, rig.capacity, f32::NAN));
    let d = rig.filled(&columns(d, outputs, rig.capacity, f32::INFINITY));
    let parts = rig.filled(&vec![UNTOUCHED; Gradient::parts(rig.capacity, shape)]);
    let found = rig.filled(&vec![UNTOUCHED; inner * outputs + 1]);
    let layer = Gradient {
        a: (&a).into(),
        d: (&d).into(),
        shape,
        capacity: rig.capacity,
        parts: (&parts).into(),
        gradient: (&found).into(),
        fault: faults::NETWORKS,
    };
    let runs = nets.gradient(rig.batch(), counts::KEPT, layer).unwrap();
    rig.gpu.submit(|recorder| runs.record(recorder));
    [rig.gpu.read(&found).unwrap(), rig.gpu.read(&parts).unwrap()]
}

/// The twin of `sum`: parts `[chunks][weights]` in 16 slices, which then are added by halves.
fn summed(parts: &[f32], weights: usize) -> Vec<f32> {
    let mut slices = vec![vec![0.0_f32; weights]; 16];
    for (chunk, part) in parts.chunks(weights).enumerate() {
        let sums = slices[chunk % 16].iter_mut();
        sums.zip(part).for_each(|(sum, part)| *sum += part);
    }
    while slices.len() > 1 {
        let above = slices.split_off(slices.len() / 2);
        for (sums, above) in slices.iter_mut().zip(above) {
            sums.iter_mut().zip(above).for_each(|(sum, above)| *sum += above);
        }
    }
    slices.concat()
}

#[test]
fn gradients_of_weights_are_those_of_the_cpu_chunk_by_chunk() {
    let test = "gradients_of_weights_are_those_of_the_cpu_chunk_by_chunk";
    // Up to 37 chunks: slices of none, one, two and three.
    for (n, [inner, outputs]) in [
        (1101, [32, 64]),
        (4701, [64, 16]),
        (512, [16, 32]),
        (3, [16, 16]),
        (2101, [4, 16]),
    ] {
        let Some(rig) = Rig::new(test, [5120, 64], [0, n as u32, 0]) else {
            return;
        };
        let (a, d) = (numbers(n * inner, 4), numbers(n * outputs, 5));
        let [found, parts] = gradient(&rig, [&a, &d], [inner, outputs]);
        let mut expected = Vec::new();
        for (a, d) in a.chunks(CHUNK * inner).zip(d.chunks(CHUNK * outputs)) {
            let mut part = vec![0.0_f32; inner * outputs];
            for (a, d) in a.chunks(inner).zip(d.chunks(outputs)) {
                for (at, sum) in part.iter_mut().enumerate() {
                    *sum = a[at / outputs].mul_add(d[at % outputs], *sum);
                }
            }
            expected.extend(part);
        }
        let name = format!("gradient of {n} samples, {inner} x {outputs}");
        agree(&name, &parts[..expected.len()], &expected, TOLERANCE);
        let sums = summed(&parts[..expected.len()], inner * outputs);
        assert_eq!(found[..inner * outputs], sums, "{name}: its own parts");
        assert_eq!(found[inner * outputs], UNTOUCHED);
        let in_use = n.div_ceil(CHUNK) * inner * outputs;
        assert!(parts[in_use..].iter().all(is_untouched), "{name}");
        assert!(parts[..in_use].iter().all(|x| !is_untouched(x)), "{name}");
        assert!(rig.faulty().is_empty());
        if inner == 32 {
            // The whole CPU kernel, which goes on where the parts begin anew.
            let (a, d) = (blocks(&a), blocks(&d));
            let mut whole = vec![Block::ZERO; inner * outputs / LANES];
            InstructionSet::best().run(gemm::Outer {
                a: &a,
                d: &d,
                g: &mut whole,
                inner,
                columns: outputs / LANES,
            });
            agree(
                &format!("{name}, in one"),
                &found[..inner * outputs],
                flat(&whole),
                TOLERANCE,
            );
        }
    }
}

#[test]
fn no_samples_give_a_gradient_of_zero_and_a_runaway_is_told() {
    let test = "no_samples_give_a_gradient_of_zero_and_a_runaway_is_told";
    for (kept, slope, faults) in [
        (0, 1.0, vec![]),
        (5, 1e9, vec![faults::NETWORKS]),
        (5, f32::NAN, vec![4]),
    ] {
        let Some(rig) = Rig::new(test, [512, 64], [0, kept, 0]) else {
            return;
        };
        let (a, mut d) = (vec![1.0; 16 * 5], vec![1.0; 16 * 5]);
        d[0] = slope;
        d[16] = slope;
        let [found, _] = gradient(&rig, [&a, &d], [16, 16]);
        assert!(kept > 0 || found[..256].iter().all(|x| *x == 0.0), "{slope}");
        assert_eq!(rig.faulty(), faults, "{slope}");
    }
}

const ROWS: usize = 70;

/// Three steps on the device; afterwards weights, means, squares, gradients and counts.
fn adam(rig: &Rig, weights: &[f32], gradients: &[Vec<f32>], count: &[u32]) -> ([Vec<f32>; 4], Vec<u32>) {
    let nets = Nets::new(&rig.gpu).unwrap();
    let bias = Nets::bias(&rig.gpu, &Bias::default()).unwrap();
    let pace = Pace {
        rate: 0.02,
        ..Pace::default()
    };
    let pace = rig.gpu.uniform("pace", pace).unwrap();
    let [w, g, m, v] = [weights, &gradients[0], &[0.0; 16 * ROWS], &[0.0; 16 * ROWS]].map(|x| rig.filled(x));
    let count = rig.gpu.filled("count", count).unwrap();
    let tensor = Tensor {
        weights: (&w).into(),
        gradient: (&g).into(),
        mean: (&m).into(),
        square: (&v).into(),
        count: (&count).into(),
        rows: ROWS - 1,
        rates: [1.0, DECAY],
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
    let read = [&w, &m, &v, &g].map(|array| rig.gpu.read(array).unwrap());
    (read, rig.gpu.read(&count).unwrap())
}

fn gradients() -> Vec<Vec<f32>> {
    let steps = (0..3).map(|step| {
        let mut gradient = numbers(16 * ROWS, 20 + step);
        // Rows without a gradient, of both zeros; one number alone; the sizes of a training; a huge one.
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
fn adam_moves_weights_as_the_cpu_does() {
    let Some(rig) = Rig::new("adam_moves_weights_as_the_cpu_does", [256, 64], [0; 3]) else {
        return;
    };
    let weights = numbers(16 * ROWS, 6);
    let mut counts = vec![0; ROWS];
    counts[4..8].copy_from_slice(&[1, 4094, 4095, u32::MAX]);
    let ([moved, mean, square, rest], count) = adam(&rig, &weights, &gradients(), &counts);
    let (mut expected, mut moments) = (weights.clone(), Moments::new(16 * ROWS, 16));
    moments.count.copy_from_slice(&counts);
    // The last row is beyond what was bound.
    let last = 16 * (ROWS - 1);
    for mut gradient in gradients() {
        gradient[last..].fill(0.0);
        InstructionSet::best().run(Adam::<16> {
            weights: &mut expected,
            gradient: &mut gradient,
            moments: &mut moments,
            rate: 0.02,
            epsilon: EPSILON,
            decay: DECAY,
            bias: &Bias::default(),
        });
    }
    agree("adam, weights", &moved, &expected, TOLERANCE);
    // The huge gradient's moments would hide all others.
    agree("adam, mean", &mean[176..], &moments.first[176..], TOLERANCE);
    agree("adam, square", &square[176..], &moments.second[176..], TOLERANCE);
    assert_eq!(count, moments.count);
    assert_eq!((&moved[..32], &moved[last..]), (&weights[..32], &weights[last..]));
    assert!(rest[..last].iter().all(|gradient| *gradient == 0.0));
    assert!(rest[last..].iter().all(|gradient| *gradient != 0.0));
}

#[test]
fn adam_stands_still_once_anything_ran_away() {
    for fault in [0, 6] {
        let Some(rig) = Rig::new("adam_stands_still_once_anything_ran_away", [256, 64], [0; 3]) else {
            return;
        };
        rig.gpu.write(&rig.faults, fault, &[1]);
        let weights = numbers(16 * ROWS, 6);
        let gradients = gradients();
        let ([moved, mean, _, rest], count) = adam(&rig, &weights, &gradients, &[0; ROWS]);
        assert_eq!(moved, weights);
        assert_eq!((mean[40], count[4], rest), (0.0, 0, gradients[2].clone()));
    }
}
