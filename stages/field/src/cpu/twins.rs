//! Every kernel on every instruction set of this machine against plain Rust: equal to the bit.

use super::adam::{Adam, Bias, Moments};
use super::composite::{Colours, Depths, ExpNeg, NotFinite};
use super::encode::{Lookup, Points, Scatter, Shape};
use super::gemm::{After, Outer, Product};
use super::march::{Bits, March, Samples, Steps};
use super::simd::{Block, LANES, Level, Plain, Stripe, flat, flat_mut};
use crate::rng::{Purpose, Rng};

fn numbers(len: usize, stream: u64) -> Vec<f32> {
    let mut rng = Rng::new(11, Purpose::Rays, 0, stream);
    (0..len).map(|_| rng.unit() * 2.0 - 1.0).collect()
}

fn blocks(len: usize, stream: u64) -> Vec<Block> {
    let mut blocks = vec![Block::default(); len];
    flat_mut(&mut blocks).copy_from_slice(&numbers(len * LANES, stream));
    blocks
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

/// Runs `work` on every set and compares with plain Rust.
fn same_on_all(name: &str, work: impl Fn(Level) -> Vec<f32>) {
    let plain = bits(&work(Level::Plain(Plain)));
    assert!(
        plain.iter().any(|bits| *bits != 0),
        "{name}: all zero proves nothing"
    );
    for level in Level::all() {
        assert_eq!(bits(&work(level)), plain, "{name} on {level:?}");
    }
}

#[test]
fn products_are_the_same_on_every_set_and_width() {
    for (inner, columns) in [(16, 1), (32, 2), (32, 4), (64, 1), (48, 3), (16, 8)] {
        let open = blocks(48 * columns, 4);
        for after in [After::Nothing, After::Relu, After::Gate(&open)] {
            same_on_all(&format!("product {inner} x {columns}"), |level| {
                let (a, b) = (blocks(48 * inner / LANES, 1), blocks(inner * columns, 2));
                let mut c = blocks(48 * columns, 3);
                level.run(Product {
                    a: &a,
                    b: &b,
                    c: &mut c,
                    inner,
                    columns,
                    after,
                });
                flat(&c).to_vec()
            });
        }
        same_on_all(&format!("outer {inner} x {columns}"), |level| {
            let (a, d) = (blocks(48 * inner / LANES, 1), blocks(48 * columns, 2));
            let mut g = blocks(inner * columns, 3);
            level.run(Outer {
                a: &a,
                d: &d,
                g: &mut g,
                inner,
                columns,
            });
            flat(&g).to_vec()
        });
    }
}

#[test]
fn a_product_of_16_by_16_is_the_sum_in_order() {
    let (a, b) = (blocks(16, 1), blocks(16, 2));
    let mut c = blocks(16, 3);
    Level::best().run(Product {
        a: &a,
        b: &b,
        c: &mut c,
        inner: 16,
        columns: 1,
        after: After::Nothing,
    });
    for row in 0..16 {
        for column in 0..16 {
            let sum = (0..16).fold(0.0_f32, |sum, k| a[row].0[k].mul_add(b[k].0[column], sum));
            assert_eq!(c[row].0[column], sum, "{row} {column}");
        }
    }
}

#[test]
fn a_relu_keeps_a_nan() {
    for level in Level::all() {
        let mut a = blocks(16, 1);
        a[3].0[0] = f32::NAN;
        let (b, mut c) = (blocks(16, 2), blocks(16, 3));
        level.run(Product {
            a: &a,
            b: &b,
            c: &mut c,
            inner: 16,
            columns: 1,
            after: After::Relu,
        });
        assert_eq!(level.run(NotFinite(&c)), 16, "{level:?}");
    }
}

#[test]
fn lookup_and_scatter_are_the_same_on_every_set() {
    let coordinates: Vec<Vec<f32>> = (0..3)
        .map(|axis| numbers(64, axis).iter().map(|x| x * 0.6 + 0.5).collect())
        .collect();
    let points = Points {
        x: &coordinates[0],
        y: &coordinates[1],
        z: &coordinates[2],
    };
    for resolution in [4, 37] {
        let shape = Shape::new(resolution, 9);
        let table = numbers(shape.entries as usize * 4, 7);
        same_on_all("lookup", |level| {
            let mut rows = blocks(64, 8);
            let to = Stripe::cut(&mut rows, 1, 4).remove(1);
            level.run(Lookup::<4> {
                shape,
                table: &table,
                points,
                to,
            });
            let to = Stripe::cut(&mut rows, 1, 2).remove(5);
            level.run(Lookup::<2> {
                shape,
                table: &table,
                points,
                to,
            });
            flat(&rows).to_vec()
        });
        same_on_all("scatter", |level| {
            let mut gradient = vec![0.0; shape.entries as usize * 4];
            let (rows, width) = (blocks(64, 8), 1);
            level.run(Scatter::<4> {
                shape,
                gradient: &mut gradient,
                points,
                rows: &rows,
                width,
                first: 4,
            });
            level.run(Scatter::<2> {
                shape,
                gradient: &mut gradient,
                points,
                rows: &rows,
                width,
                first: 10,
            });
            gradient
        });
    }
}

#[test]
fn adam_and_the_exponentials_are_the_same_on_every_set() {
    same_on_all("adam", |level| {
        let (mut weights, mut gradient) = (numbers(64, 1), numbers(64, 2));
        gradient[8..24].fill(0.0);
        let mut moments = Moments::new(64, 4);
        let bias = Bias::default();
        for _ in 0..3 {
            let (weights, gradient, moments) = (&mut weights, &mut gradient, &mut moments);
            let (rate, epsilon, decay, bias) = (0.01, 1e-12, 1e-6, &bias);
            level.run(Adam::<4> {
                weights,
                gradient,
                moments,
                rate,
                epsilon,
                decay,
                bias,
            });
            gradient.copy_from_slice(&numbers(64, 5));
        }
        [weights, moments.first, moments.second].concat()
    });
    same_on_all("depths", |level| {
        let raw: Vec<f32> = numbers(64, 1).iter().map(|x| x * 20.0).collect();
        let delta: Vec<f32> = numbers(64, 2).iter().map(|x| x.abs()).collect();
        let (mut tau, mut alpha) = (vec![0.0; 64], vec![0.0; 64]);
        level.run(Depths {
            raw: &raw,
            delta: &delta,
            tau: &mut tau,
            alpha: &mut alpha,
        });
        let mut left = tau.clone();
        level.run(ExpNeg(&mut left));
        [tau, alpha, left].concat()
    });
    same_on_all("colours", |level| {
        let mut logits = blocks(32, 1);
        flat_mut(&mut logits).iter_mut().for_each(|logit| *logit *= 15.0);
        let mut rgb = vec![[0.0; 4]; 32];
        level.run(Colours {
            logits: &logits,
            rgb: &mut rgb,
        });
        rgb.concat()
    });
}

#[test]
fn marching_is_the_same_on_every_set() {
    let steps = Steps::new(0.05, 100.0, 0.02, 0.03);
    let mut cells = Bits::new(16);
    (0..4096)
        .filter(|cell| cell % 3 == 0)
        .for_each(|cell| cells.set(cell));
    same_on_all("march", |level| {
        let mut samples = Samples::default();
        for stream in 0..20 {
            let random = numbers(6, stream);
            let norm = (random[3].powi(2) + random[4].powi(2) + random[5].powi(2)).sqrt();
            level.run(March {
                steps: &steps,
                bits: &cells,
                origin: [random[0], random[1], random[2]],
                direction: [random[3] / norm, random[4] / norm, random[5] / norm],
                jitter: 0.3,
                first: 0,
                limit: usize::MAX,
                samples: &mut samples,
            });
        }
        [
            samples.x,
            samples.y,
            samples.z,
            samples.t,
            samples.delta,
            samples.place,
        ]
        .concat()
    });
}
