//! The kernels at 2^16 samples, as a training step runs them.

use std::fmt;
use std::hint::black_box;
use std::sync::Mutex;

use marf_field::bench::adam::{Adam, Bias, Moments};
use marf_field::bench::composite::{Colours, Depths, ExpNeg, Ray};
use marf_field::bench::encode::{Lookup, Points, Scatter, Shape};
use marf_field::bench::march::{Bits, March, Samples, Steps};
use marf_field::bench::net::Net;
use marf_field::bench::simd::{Block, LANES, Level, flat_mut};
use rayon::prelude::*;

use crate::ceilings;
use crate::clock::{Threads, best};

/// Samples a ray.
const RAY: usize = 64;
/// Samples a task of a network.
const CHUNK: usize = 768;

/// Name, and a run that returns rate and ceiling in million samples (numbers, rays) a second.
type Run = fn(&Field, Level, &Threads, &Limits, f64) -> [f64; 2];

/// The kernels.
pub const KERNELS: [(&str, Run); 9] = [
    ("encode", encode),
    ("scatter", scatter),
    ("density forward", |field, level, threads, _, peak| {
        network(&field.density, level, threads, peak, false)
    }),
    (
        "density forward and backward",
        |field, level, threads, _, peak| network(&field.density, level, threads, peak, true),
    ),
    ("colour forward", |field, level, threads, _, peak| {
        network(&field.color, level, threads, peak, false)
    }),
    ("colour forward and backward", |field, level, threads, _, peak| {
        network(&field.color, level, threads, peak, true)
    }),
    ("adam (numbers)", adam),
    ("composite forward and backward", composite),
    ("march (rays)", march),
];

/// A field's shape.
pub struct Field {
    pub name: &'static str,
    features: usize,
    shapes: Vec<Shape>,
    density: Vec<usize>,
    color: Vec<usize>,
}

/// Ceilings of memory.
pub struct Limits {
    triad: f64,
    /// Random rows of a full table: read, added to.
    rows: [f64; 2],
}

impl Limits {
    pub fn kind(&self, name: &str) -> &'static str {
        match name {
            "encode" => "random reads",
            "scatter" => "random sums",
            "adam (numbers)" => "stream",
            _ => "multiply-add",
        }
    }
}

impl fmt::Display for Limits {
    fn fmt(&self, out: &mut fmt::Formatter) -> fmt::Result {
        let Self { triad, rows } = self;
        write!(
            out,
            "triad {triad:.1} GB/s; random rows {:.0} M/s read, {:.0} M/s added to",
            rows[0], rows[1]
        )
    }
}

impl Field {
    fn new(
        name: &'static str,
        levels: u32,
        features: usize,
        log2_table: u32,
        width: usize,
        layers: usize,
    ) -> Self {
        let growth = (2048_f64 / 16.0).powf(1.0 / f64::from(levels - 1));
        let side = |level: u32| (16.0 * growth.powi(level as i32)).round() as u32;
        let mut color = vec![32];
        color.extend(std::iter::repeat_n(width, layers));
        color.push(16);
        Self {
            name,
            features,
            shapes: (0..levels)
                .map(|level| Shape::new(side(level), log2_table))
                .collect(),
            density: vec![levels as usize * features, width, 16],
            color,
        }
    }

    pub fn fixed() -> Self {
        Self::new("fixed", 16, 2, 19, 64, 2)
    }

    pub fn default() -> Self {
        Self::new("default", 8, 4, 15, 32, 1)
    }

    pub fn limits(&self, threads: &Threads) -> Limits {
        let rows = self.shapes.last().map_or(1, |shape| shape.entries as usize);
        Limits {
            triad: ceilings::triad(threads),
            rows: match self.features {
                2 => ceilings::random::<2>(rows, threads),
                _ => ceilings::random::<4>(rows, threads),
            },
        }
    }

    fn width(&self) -> usize {
        self.shapes.len() * self.features / LANES
    }

    fn tables(&self) -> Vec<Vec<f32>> {
        let table = |shape: &Shape| numbers(shape.entries as usize * self.features, 3);
        self.shapes.iter().map(table).collect()
    }
}

/// Samples of a run; plain Rust calls a function for every multiply-add.
fn samples(level: Level) -> usize {
    if matches!(level, Level::Plain(_)) {
        1 << 13
    } else {
        1 << 16
    }
}

/// Uniform in [-1, 1].
fn numbers(count: usize, seed: u64) -> Vec<f32> {
    let mut state = seed;
    let draw = |_| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / 8_388_608.0 - 1.0
    };
    (0..count).map(draw).collect()
}

fn blocks(count: usize, seed: u64) -> Vec<Block> {
    let mut blocks = vec![Block::default(); count];
    flat_mut(&mut blocks).copy_from_slice(&numbers(count * LANES, seed));
    blocks
}

/// Points along rays through the unit box, a step of sqrt(3) / 1024 apart.
fn points(count: usize) -> [Vec<f32>; 3] {
    let random = numbers(count / RAY * 6, 5);
    let mut axes = [const { Vec::new() }; 3];
    for ray in random.chunks_exact(6) {
        let norm = ray[3..].iter().map(|part| part * part).sum::<f32>().sqrt();
        for step in 0..RAY {
            let t = step as f32 * 1.732 / 1024.0;
            for axis in 0..3 {
                let at = ray[axis] * 0.5 + 0.5 + ray[3 + axis] / norm * t;
                axes[axis].push(at.clamp(0.0, 1.0));
            }
        }
    }
    axes
}

fn part([x, y, z]: &[Vec<f32>; 3], from: usize, count: usize) -> Points<'_> {
    let [x, y, z] = [x, y, z].map(|axis| &axis[from..from + count]);
    Points { x, y, z }
}

fn encode(field: &Field, level: Level, threads: &Threads, limits: &Limits, _peak: f64) -> [f64; 2] {
    let (count, width, features) = (samples(level), field.width(), field.features);
    let (axes, tables) = (points(count), field.tables());
    let mut rows = blocks(count * width, 1);
    let chunk = count / 8;
    let mut time_s = 0.0;
    for (index, (shape, table)) in field.shapes.iter().zip(&tables).enumerate() {
        let first = index * features;
        let mut pass = || {
            rows.par_chunks_mut(chunk * width)
                .enumerate()
                .for_each(|(number, rows)| {
                    let (shape, points) = (*shape, part(&axes, number * chunk, chunk));
                    match features {
                        2 => level.run(Lookup::<2> {
                            shape,
                            table,
                            points,
                            rows,
                            width,
                            first,
                        }),
                        _ => level.run(Lookup::<4> {
                            shape,
                            table,
                            points,
                            rows,
                            width,
                            first,
                        }),
                    }
                });
        };
        time_s += threads.run(|_| best(&mut pass));
    }
    [
        count as f64 / time_s / 1e6,
        limits.rows[0] / (8 * field.shapes.len()) as f64,
    ]
}

/// One level a thread at a time.
fn scatter(field: &Field, level: Level, threads: &Threads, limits: &Limits, _peak: f64) -> [f64; 2] {
    let (count, width, features) = (samples(level), field.width(), field.features);
    let (axes, mut tables) = (points(count), field.tables());
    let rows = &blocks(count * width, 1)[..];
    let mut time_s = 0.0;
    let groups = field
        .shapes
        .chunks(threads.count)
        .zip(tables.chunks_mut(threads.count));
    for (group, (shapes, tables)) in groups.enumerate() {
        let mut pass = || {
            shapes
                .par_iter()
                .zip(&mut *tables)
                .enumerate()
                .with_max_len(1)
                .for_each(|(index, (shape, gradient))| {
                    let first = (group * threads.count + index) * features;
                    let (shape, points) = (*shape, part(&axes, 0, count));
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
                });
        };
        time_s += threads.run(|_| best(&mut pass));
    }
    [
        count as f64 / time_s / 1e6,
        limits.rows[1] / (8 * field.shapes.len()) as f64,
    ]
}

/// Memory of one task.
#[derive(Default)]
struct Scratch {
    activations: Vec<Vec<Block>>,
    slope: Vec<Block>,
    spare: Vec<Block>,
}

fn network(widths: &[usize], level: Level, threads: &Threads, peak: f64, backward: bool) -> [f64; 2] {
    let count = samples(level);
    let mut net = Net::new(widths);
    for layer in &mut net.layers {
        layer.weights = blocks(layer.weights.len(), 2);
        layer.refresh();
    }
    let (last, gradients) = (widths.len() - 1, net.gradients());
    let (input, slopes) = (
        blocks(count * widths[0] / LANES, 3),
        blocks(CHUNK * widths[last] / LANES, 4),
    );
    let scratch: Vec<_> = (0..threads.count)
        .map(|_| Mutex::new((Scratch::default(), gradients.clone())))
        .collect();
    let time_s = threads.run(|_| {
        best(|| {
            input.par_chunks(CHUNK * widths[0] / LANES).for_each(|input| {
                let mut held = scratch[rayon::current_thread_index().unwrap_or(0)]
                    .lock()
                    .expect("one a thread");
                let (
                    Scratch {
                        activations,
                        slope,
                        spare,
                    },
                    gradients,
                ) = &mut *held;
                net.forward(level, input, activations);
                if backward {
                    slope.clear();
                    slope.extend_from_slice(&slopes[..input.len() * widths[last] / widths[0]]);
                    net.backward(level, input, activations, slope, spare, gradients);
                }
                black_box(slope.len());
            });
        })
    });
    let products: usize = widths.windows(2).map(|pair| pair[0] * pair[1]).sum();
    let flop = products as f64 * if backward { 6.0 } else { 2.0 };
    [count as f64 / time_s / 1e6, peak * 1e3 / flop]
}

fn adam(field: &Field, level: Level, threads: &Threads, limits: &Limits, _peak: f64) -> [f64; 2] {
    let mut tables = field.tables();
    let moments = |table: &Vec<f32>| Moments::new(table.len(), field.features);
    let mut moments: Vec<_> = tables.iter().map(moments).collect();
    let mut gradients = field.tables();
    let fresh = field.tables();
    let bias = &Bias::default();
    let count: usize = tables.iter().map(Vec::len).sum();
    let mut shortest = f64::MAX;
    let runs = if matches!(level, Level::Plain(_)) { 2 } else { 12 };
    for _ in 0..runs {
        gradients.clone_from(&fresh);
        let time_s = threads.run(|_| {
            let start = std::time::Instant::now();
            let tasks = tables
                .par_iter_mut()
                .zip(&mut gradients)
                .zip(&mut moments)
                .with_max_len(1);
            tasks.for_each(|((weights, gradient), moments)| {
                let (rate, epsilon, decay) = (1e-2, 1e-12, 0.0);
                match field.features {
                    2 => level.run(Adam::<2> {
                        weights,
                        gradient,
                        moments,
                        rate,
                        epsilon,
                        decay,
                        bias,
                    }),
                    _ => level.run(Adam::<4> {
                        weights,
                        gradient,
                        moments,
                        rate,
                        epsilon,
                        decay,
                        bias,
                    }),
                }
            });
            start.elapsed().as_secs_f64()
        });
        shortest = shortest.min(time_s);
    }
    [count as f64 / shortest / 1e6, limits.triad * 1e3 / 32.0]
}

/// One task: the samples of 16 rays.
struct Rays {
    raw: Vec<f32>,
    tau: Vec<f32>,
    alpha: Vec<f32>,
    transmittance: Vec<f32>,
    rgb: Vec<[f32; 4]>,
    d_tau: Vec<f32>,
    d_rgb: Vec<[f32; 4]>,
}

fn composite(_: &Field, level: Level, threads: &Threads, _: &Limits, peak: f64) -> [f64; 2] {
    let (count, task) = (samples(level), 16 * RAY);
    let delta = vec![0.01; task];
    let place: Vec<f32> = (0..task).map(|k| (k % RAY) as f32 / RAY as f32).collect();
    let logits = blocks(task, 6);
    let mut tasks: Vec<Rays> = (0..count / task)
        .map(|seed| Rays {
            raw: numbers(task, seed as u64),
            tau: vec![0.0; task],
            alpha: vec![0.0; task],
            transmittance: vec![0.0; task],
            rgb: vec![[0.0; 4]; task],
            d_tau: vec![0.0; task],
            d_rgb: vec![[0.0; 4]; task],
        })
        .collect();
    let time_s = threads.run(|_| {
        best(|| {
            tasks.par_iter_mut().for_each(|rays| {
                let Rays {
                    raw,
                    tau,
                    alpha,
                    transmittance,
                    rgb,
                    d_tau,
                    d_rgb,
                } = rays;
                level.run(Depths {
                    raw,
                    delta: &delta,
                    tau,
                    alpha,
                });
                for first in (0..task).step_by(RAY) {
                    let mut depth = 0.0;
                    for index in first..first + RAY {
                        transmittance[index] = depth;
                        depth += tau[index];
                    }
                }
                level.run(ExpNeg(transmittance));
                level.run(Colours { logits: &logits, rgb });
                for first in (0..task).step_by(RAY) {
                    let span = first..first + RAY;
                    let ray = Ray {
                        alpha: &alpha[span.clone()],
                        transmittance: &transmittance[span.clone()],
                        rgb: &rgb[span.clone()],
                        place: &place[span.clone()],
                    };
                    let found = ray.gather();
                    ray.spread(
                        found.rgb,
                        [0.5; 3],
                        [1e-3, 0.01],
                        &mut d_tau[span.clone()],
                        &mut d_rgb[span],
                    );
                }
            })
        })
    });
    // Two exponentials for opacity and transmittance, one for density, four for colours: about 200 operations.
    [count as f64 / time_s / 1e6, peak * 1e3 / 200.0]
}

fn march(_: &Field, level: Level, threads: &Threads, _: &Limits, peak: f64) -> [f64; 2] {
    let steps = Steps::new(0.1, 512.0, 0.03, 0.04);
    let mut bits = Bits::new(128);
    // A shell: about 1 cell in 20.
    for cell in 0..128_usize.pow(3) {
        let at = [cell % 128, cell / 128 % 128, cell / 128 / 128].map(|at| at as f32 - 63.5);
        let radius = at.iter().map(|at| at * at).sum::<f32>().sqrt();
        if (radius - 24.0).abs() < 3.0 {
            bits.set(cell);
        }
    }
    let count = samples(level) / 16;
    let random = numbers(count * 6, 9);
    let time_s = threads.run(|_| {
        best(|| {
            random.par_chunks(6 * 32).for_each(|rays| {
                let mut samples = Samples::default();
                for ray in rays.chunks_exact(6) {
                    let norm = ray[3..].iter().map(|part| part * part).sum::<f32>().sqrt();
                    level.run(March {
                        steps: &steps,
                        bits: &bits,
                        origin: [ray[0], ray[1], ray[2]],
                        direction: [ray[3] / norm, ray[4] / norm, ray[5] / norm],
                        jitter: 0.5,
                        first: 0,
                        limit: usize::MAX,
                        samples: &mut samples,
                    });
                }
                black_box(samples.len());
            })
        })
    });
    // About 40 operations a step.
    [
        count as f64 / time_s / 1e6,
        peak * 1e3 / (40 * steps.count) as f64,
    ]
}
