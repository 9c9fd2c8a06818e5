//! Every kernel on every instruction set of this machine against plain Rust: equal to the bit.

use super::adam::{Adam, Bias, Moments};
use super::composite::{Colours, Depths, ExpNeg, RUNAWAY, Runaways};
use super::encode::{Lookup, Points, Scatter, Shape};
use super::gemm::{After, Outer, Product};
use super::march::{March, Samples, Steps};
use super::simd::{Block, InstructionSet, Isa, Kernel, LANES, Plain, Run, Stripe, flat, flat_mut};
use super::space::Bits;
use crate::rng::{Purpose, random_numbers};

pub fn numbers(len: usize, stream: u64) -> Vec<f32> {
    let mut rng = random_numbers(11, Purpose::Rays, 0, stream);
    (0..len).map(|_| rng.unit_f32() * 2.0 - 1.0).collect()
}

pub fn blocks(len: usize, stream: u64) -> Vec<Block> {
    let mut blocks = vec![Block::default(); len];
    flat_mut(&mut blocks).copy_from_slice(&numbers(len * LANES, stream));
    blocks
}

pub fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

/// Runs `work` on every set and compares with plain Rust.
fn same_on_all(name: &str, work: impl Fn(InstructionSet) -> Vec<f32>) {
    let plain = bits(&work(InstructionSet::Plain(Plain)));
    assert!(
        plain.iter().any(|bits| *bits != 0),
        "{name}: all zero proves nothing"
    );
    for level in InstructionSet::all() {
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
                    steps: inner,
                    across: columns,
                    columns,
                    after,
                });
                flat(&c).to_vec()
            });
        }
        // More rows than are summed at a time.
        same_on_all(&format!("outer {inner} x {columns}"), |level| {
            let (a, d) = (blocks(592 * inner / LANES, 1), blocks(592 * columns, 2));
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
    InstructionSet::best().run(Product {
        a: &a,
        b: &b,
        c: &mut c,
        inner: 16,
        steps: 16,
        across: 1,
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
    for level in InstructionSet::all() {
        let mut a = blocks(16, 1);
        a[3].0[0] = f32::NAN;
        let (b, mut c) = (blocks(16, 2), blocks(16, 3));
        level.run(Product {
            a: &a,
            b: &b,
            c: &mut c,
            inner: 16,
            steps: 16,
            across: 1,
            columns: 1,
            after: After::Relu,
        });
        let nans = flat(&c).iter().filter(|value| value.is_nan()).count();
        assert_eq!(nans, 16, "{level:?}");
    }
}

#[test]
fn a_number_that_runs_away_is_found_in_every_lane_and_in_the_rest() {
    for level in InstructionSet::all() {
        let calm = vec![-RUNAWAY.next_down(); 37];
        assert!(!level.run(Runaways(&calm)), "{level:?}");
        assert!(!level.run(Runaways(&[])), "{level:?}");
        for wild in [RUNAWAY, -RUNAWAY, f32::NEG_INFINITY, f32::NAN, -f32::NAN] {
            for at in 0..calm.len() {
                let mut values = calm.clone();
                values[at] = wild;
                assert!(level.run(Runaways(&values)), "{level:?}: {wild} at {at}");
            }
        }
    }
}

/// Sums of the first 3 of 16 numbers are those of all where the rest are zero, and columns do not depend on their neighbours.
#[test]
fn a_part_of_a_product_is_that_part_of_the_whole() {
    for level in InstructionSet::all() {
        let product = |a: &[Block], steps, columns| {
            let (b, mut c) = (blocks(32, 2), blocks(16 * columns, 3));
            level.run(Product {
                a,
                b: &b,
                c: &mut c,
                inner: 16,
                steps,
                across: 2,
                columns,
                after: After::Nothing,
            });
            c
        };
        let mut a = blocks(16, 1);
        a.iter_mut().for_each(|row| row.0[3..].fill(0.0));
        let whole = product(&a, 16, 2);
        assert_eq!(product(&a, 3, 2), whole, "{level:?}");
        let left: Vec<Block> = whole.iter().step_by(2).copied().collect();
        assert_eq!(product(&a, 16, 1), left, "{level:?}");
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
            let (rows, stride) = (blocks(64, 8), LANES);
            level.run(Scatter::<4> {
                shape,
                gradient: &mut gradient,
                points,
                rows: &rows,
                stride,
                first: 4,
            });
            level.run(Scatter::<2> {
                shape,
                gradient: &mut gradient,
                points,
                rows: &rows,
                stride,
                first: 10,
            });
            gradient
        });
    }
}

#[test]
fn any_number_of_rows_moves_row_by_row() {
    // 13 rows of 2 are not a whole number of vectors. Every third has no gradient.
    let moved = |level: InstructionSet, rows: usize| {
        let (mut weights, mut gradient) = (numbers(26, 1), numbers(26, 2));
        weights.truncate(rows * 2);
        gradient.truncate(rows * 2);
        gradient.chunks_mut(2).step_by(3).for_each(|row| row.fill(0.0));
        let mut moments = Moments::new(rows * 2, 2);
        level.run(Adam::<2> {
            weights: &mut weights,
            gradient: &mut gradient,
            moments: &mut moments,
            rate: 0.01,
            epsilon: 1e-12,
            decay: 0.0,
            bias: &Bias::default(),
        });
        assert!(gradient.iter().all(|slope| *slope == 0.0));
        let counts = (0..rows).map(|row| u32::from(row % 3 > 0));
        assert_eq!(moments.count, counts.collect::<Vec<u32>>(), "{rows} rows");
        [weights, moments.first, moments.second].map(|numbers| bits(&numbers))
    };
    let plain = moved(InstructionSet::Plain(Plain), 13);
    for level in InstructionSet::all() {
        assert_eq!(moved(level, 13), plain, "{level:?}");
        for rows in 0..13 {
            let fewer = moved(level, rows);
            for (fewer, all) in fewer.iter().zip(&plain) {
                assert_eq!(*fewer, all[..rows * 2], "{level:?}, {rows} rows");
            }
        }
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

/// Lanes of a block, packed over numbers that were there before.
struct Packed(Block, u16);

impl Kernel for Packed {
    type Output = [f32; LANES];

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) -> [f32; LANES] {
        let mut to = [9.0; LANES];
        isa.pack(isa.load(&self.0), self.1, &mut to);
        to
    }
}

#[test]
fn lanes_are_packed_in_order_and_zero_behind_on_every_set() {
    let mut from = blocks(1, 6)[0];
    (from.0[3], from.0[11]) = (f32::NAN, f32::NEG_INFINITY);
    for level in InstructionSet::all() {
        for lanes in 0..=u16::MAX {
            let picked = (0..LANES).filter(|lane| lanes >> lane & 1 == 1);
            let mut expected: Vec<f32> = picked.map(|lane| from.0[lane]).collect();
            expected.resize(LANES, 0.0);
            let packed = level.run(Packed(from, lanes));
            assert_eq!(bits(&packed), bits(&expected), "{lanes:#018b} on {level:?}");
        }
    }
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
                clearance: None,
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
