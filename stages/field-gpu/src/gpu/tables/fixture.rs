//! Tables, samples and slopes that the tests of kernels share, and what the CPU makes of them.

use crate::gpu::testing::numbers;
use marf_field::cpu::encode::{Points, Scatter, Shape};
use marf_field::cpu::simd::{Block, InstructionSet, LANES, Run, Stripe, flat, flat_mut};
use marf_field::planes::GridLevel;

/// Slots of a column.
pub const CAPACITY: usize = 1024;

/// A small field.
pub struct Case {
    pub features: usize,
    pub shapes: Vec<Shape>,
    pub tables: Vec<Vec<f32>>,
    /// `[3][CAPACITY]`.
    pub xyz: Vec<f32>,
    /// `[L * F][CAPACITY]`.
    pub slopes: Vec<f32>,
}

impl Case {
    /// Dense and hashed levels, random samples with the extremes first.
    pub fn new(features: usize) -> Self {
        let shapes: Vec<Shape> = [(4, 14), (16, 14), (32, 12), (60, 11)]
            .map(|(side, log2_table)| Shape::new(side, log2_table))
            .to_vec();
        let tables = shapes.iter().zip(0..);
        let tables = tables.map(|(shape, stream)| numbers(shape.entries as usize * features, stream));
        let mut xyz: Vec<f32> = numbers(3 * CAPACITY, 10).iter().map(|x| 0.5 + 0.5 * x).collect();
        let below_one = 1.0 - f32::EPSILON / 2.0;
        let extremes = [
            [0.0, 0.0, 0.0],
            [1.0, 1.0, 1.0],
            [f32::NAN, 0.5, f32::NAN],
            [-1.0, 2.0, f32::INFINITY],
            [f32::NEG_INFINITY, -0.0, 1e30],
            [below_one, 1e-40, below_one],
        ];
        for (sample, at) in extremes.iter().enumerate() {
            for axis in 0..3 {
                xyz[axis * CAPACITY + sample] = at[axis];
            }
        }
        Self {
            features,
            tables: tables.collect(),
            slopes: numbers(shapes.len() * features * CAPACITY, 11),
            shapes,
            xyz,
        }
    }

    /// Levels, samples and slopes whose products and sums all are floats: multiples of 2^-24 below 1.
    pub fn exact() -> Self {
        let mut case = Self::new(2);
        case.shapes = [(4, 14), (16, 14), (32, 12)]
            .map(|(side, log2_table)| Shape::new(side, log2_table))
            .to_vec();
        let steps = |x: f32, of: f32| (x * of).round() / of;
        case.xyz = numbers(3 * CAPACITY, 12)
            .iter()
            .map(|x| steps(0.5 + 0.5 * x, 128.0))
            .collect();
        // Weights are multiples of 2^-15 (of 32 cells with 5 steps each, three axes), slopes of 2^-2: sums stay
        // below 2^7.
        case.slopes = numbers(3 * 2 * CAPACITY, 13)
            .iter()
            .map(|x| steps(*x, 4.0))
            .collect();
        case
    }

    /// All samples in their order.
    pub fn origin(&self) -> Vec<u32> {
        (0..CAPACITY as u32).collect()
    }

    fn points(&self) -> Points<'_> {
        let (x, yz) = self.xyz.split_at(CAPACITY);
        let (y, z) = yz.split_at(CAPACITY);
        Points { x, y, z }
    }

    /// The CPU's features, `[L * F][CAPACITY]`.
    pub fn features(&self) -> Vec<f32> {
        let rows = self.shapes.len() * self.features;
        let width = rows.div_ceil(LANES);
        let mut blocks = vec![Block::ZERO; CAPACITY * width];
        let stripes = Stripe::cut(&mut blocks, width, self.features);
        for ((shape, table), stripe) in self.shapes.iter().zip(&self.tables).zip(stripes) {
            GridLevel::new(self.features, *shape, table).lookup(
                InstructionSet::best(),
                self.points(),
                stripe,
            );
        }
        let numbers = flat(&blocks);
        let columns = (0..rows).flat_map(|row| (0..CAPACITY).map(move |sample| (row, sample)));
        columns
            .map(|(row, sample)| numbers[sample * width * LANES + row])
            .collect()
    }

    /// The CPU's gradient of all entries, level by level without gaps, and how many corners of samples share every
    /// entry.
    pub fn gradient(&self, used: usize) -> (Vec<f32>, Vec<f32>) {
        let rows = self.shapes.len() * self.features;
        let width = rows.div_ceil(LANES);
        let mut blocks = vec![Block::ZERO; CAPACITY * width];
        for (row, column) in self.slopes.chunks(CAPACITY).enumerate() {
            for (sample, slope) in column.iter().enumerate().take(used) {
                flat_mut(&mut blocks)[sample * width * LANES + row] = *slope;
            }
        }
        let (mut all, mut contributions) = (Vec::new(), Vec::new());
        for (index, shape) in self.shapes.iter().enumerate() {
            let mut gradient = vec![0.0; shape.entries as usize * self.features];
            self.scatter(index, &mut gradient, &blocks);
            all.extend(gradient);
            contributions.extend(self.touched(shape, used));
        }
        (all, contributions)
    }

    /// How many corners of samples share every entry.
    fn touched(&self, shape: &Shape, used: usize) -> Vec<f32> {
        let mut touched = vec![0.0; shape.entries as usize];
        for sample in 0..used {
            let cell = [0, 1, 2].map(|axis| {
                let x = self.xyz[axis * CAPACITY + sample];
                let x = if x > 0.0 { x.min(1.0) } else { 0.0 };
                ((x * shape.resolution as f32) as u32).min(shape.resolution - 1)
            });
            for corner in 0..8 {
                let [x, y, z] = [0, 1, 2].map(|axis| cell[axis] + (corner >> axis & 1));
                let side = shape.resolution + 1;
                let [prime_y, prime_z] = marf_field::cpu::encode::PRIMES;
                let entry = if shape.dense {
                    x + side * (y + side * z)
                } else {
                    (x ^ y.wrapping_mul(prime_y) ^ z.wrapping_mul(prime_z)) & (shape.entries - 1)
                };
                touched[entry as usize] += 1.0;
            }
        }
        touched
    }

    /// Adds the gradients of one level's features to those of its entries. `rows`: of all features.
    fn scatter(&self, index: usize, gradient: &mut [f32], rows: &[Block]) {
        let (shape, points) = (self.shapes[index], self.points());
        let stride = rows.len() / CAPACITY * LANES;
        let first = index * self.features;
        match self.features {
            2 => InstructionSet::best().run(Scatter::<2> {
                shape,
                gradient,
                points,
                rows,
                stride,
                first,
            }),
            _ => InstructionSet::best().run(Scatter::<4> {
                shape,
                gradient,
                points,
                rows,
                stride,
                first,
            }),
        }
    }
}
