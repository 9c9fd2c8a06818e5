//! The kernels at 2^16 samples, as a training step runs them.

use std::fmt;
use std::hint::black_box;

use marf_field::bench::adam::{Adam, Bias, Moments};
use marf_field::bench::clearance::Clearance;
use marf_field::bench::composite::{Colours, Depths, ExpNeg, Gather, Ray, Spread};
use marf_field::bench::encode::{Lookup, Points, Scatter, Shape};
use marf_field::bench::march::{Bits, March, Samples, Steps};
use marf_field::bench::net::{Layer, Net};
use marf_field::bench::simd::{Block, InstructionSet, LANES, Run, Stripe, flat_mut};

use marf_field::{Config, Facts};

use crate::ceilings;
use crate::clock::{Threads, best, once};

/// Samples a ray.
const RAY: usize = 64;
/// Samples a task of a network.
const CHUNK: usize = 768;

/// Name, and a run that returns rate and ceiling in million samples (numbers, rays) a second.
type Work = fn(&Field, InstructionSet, &Threads, &Limits, f64) -> [f64; 2];

/// The kernels.
pub const KERNELS: [(&str, Work); 9] = [
    ("encode", encode),
    ("scatter", scatter),
    ("density forward", |field, level, threads, _, peak| {
        network(&field.density_net(), level, threads, peak, Direction::Forward)
    }),
    (
        "density forward and backward",
        |field, level, threads, _, peak| network(&field.density_net(), level, threads, peak, Direction::Both),
    ),
    ("colour forward", |field, level, threads, _, peak| {
        network(&field.color_net(), level, threads, peak, Direction::Forward)
    }),
    ("colour forward and backward", |field, level, threads, _, peak| {
        network(&field.color_net(), level, threads, peak, Direction::Both)
    }),
    ("adam (numbers)", adam),
    ("composite forward and backward", composite),
    ("march (rays)", march),
];

/// What of a network is run.
#[derive(Clone, Copy, PartialEq)]
enum Direction {
    Forward,
    Both,
}

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
    pub fn new(
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

    /// Returns the shape of a field that was trained.
    pub fn of(facts: &Facts, config: &Config) -> Self {
        let levels = facts.levels.iter();
        let mut color = vec![32];
        color.extend((0..config.color_layers).map(|_| config.color_width as usize));
        color.push(16);
        Self {
            name: "trained",
            features: config.features as usize,
            shapes: levels
                .map(|level| Shape::new(level.resolution, facts.sizes.log2_table.value))
                .collect(),
            density: vec![
                facts.levels.len() * config.features as usize,
                config.density_width as usize,
                16,
            ],
            color,
        }
    }

    /// Returns how many numbers the tables hold.
    pub fn numbers(&self) -> f64 {
        let entries = self.shapes.iter().map(|shape| f64::from(shape.entries));
        entries.sum::<f64>() * self.features as f64
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
fn samples(level: InstructionSet) -> usize {
    if matches!(level, InstructionSet::Plain(_)) {
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

fn whole([x, y, z]: &[Vec<f32>; 3]) -> Points<'_> {
    Points { x, y, z }
}

/// Level by level over all points, as long as one level's table is in the cache.
fn encode(field: &Field, level: InstructionSet, threads: &Threads, limits: &Limits, _peak: f64) -> [f64; 2] {
    let (count, width, features) = (samples(level), field.width(), field.features);
    let (axes, tables) = (points(count), field.tables());
    let rate = threads.rate(|_| {
        let (mut rows, plane) = (blocks(count * width, 1), count * features / LANES);
        let levels = field.shapes.iter().zip(&tables).enumerate();
        levels
            .map(|(index, (shape, table))| {
                best(|| {
                    let (shape, points) = (*shape, whole(&axes));
                    let to = Stripe::plane(&mut rows[index * plane..][..plane], features);
                    match features {
                        2 => level.run(Lookup::<2> {
                            shape,
                            table,
                            points,
                            to,
                        }),
                        _ => level.run(Lookup::<4> {
                            shape,
                            table,
                            points,
                            to,
                        }),
                    }
                })
            })
            .sum()
    });
    [
        rate * count as f64 / 1e6,
        limits.rows[0] / (8 * field.shapes.len()) as f64,
    ]
}

/// Every thread has its own tables: in training it has its own levels.
fn scatter(field: &Field, level: InstructionSet, threads: &Threads, limits: &Limits, _peak: f64) -> [f64; 2] {
    let (count, width, features) = (samples(level), field.width(), field.features);
    let axes = points(count);
    let (rows, plane) = (&blocks(count * width, 1)[..], count * features / LANES);
    let rate = threads.rate(|_| {
        let mut tables = field.tables();
        let levels = field.shapes.iter().zip(&mut tables).enumerate();
        levels
            .map(|(index, (shape, gradient))| {
                best(|| {
                    let (shape, points, first, stride) = (*shape, whole(&axes), 0, features);
                    let rows = &rows[index * plane..][..plane];
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
                })
            })
            .sum()
    });
    [
        rate * count as f64 / 1e6,
        limits.rows[1] / (8 * field.shapes.len()) as f64,
    ]
}

/// One chunk of samples again and again, as many as training takes at once.
fn network(
    (net, products): &(Net, [usize; 2]),
    level: InstructionSet,
    threads: &Threads,
    peak: f64,
    direction: Direction,
) -> [f64; 2] {
    let width = |layer: Option<&Layer>, side: fn(&Layer) -> usize| layer.map_or(0, side);
    let inputs = width(net.layers.first(), |layer| layer.inputs);
    let outputs = width(net.layers.last(), |layer| layer.outputs);
    let rate = threads.rate(|_| {
        let (input, slopes) = (
            blocks(CHUNK * inputs / LANES, 3),
            blocks(CHUNK * outputs / LANES, 4),
        );
        let (mut activations, mut gradients) = (Vec::new(), Vec::new());
        net.shape_gradients(&mut gradients);
        let (mut slope, mut spare) = (Vec::new(), Vec::new());
        best(|| {
            net.forward(level, &input, &mut activations);
            if direction == Direction::Both {
                slope.clone_from(&slopes);
                net.backward(
                    level,
                    &input,
                    &activations,
                    &mut slope,
                    &mut spare,
                    &mut gradients,
                );
            }
        })
    });
    let [forward, backward] = products;
    let sums = if direction == Direction::Both {
        forward + backward
    } else {
        *forward
    };
    [rate * CHUNK as f64 / 1e6, peak * 1e3 / (2 * sums) as f64]
}

impl Field {
    /// The density network, and the products a sample forward and backward.
    fn density_net(&self) -> (Net, [usize; 2]) {
        let forward: usize = self.density.windows(2).map(|pair| pair[0] * pair[1]).sum();
        (drawn(Net::new(&self.density)), [forward, 2 * forward])
    }

    /// The colour network: gradients of 3 of its outputs, carried back to the first 16 inputs.
    fn color_net(&self) -> (Net, [usize; 2]) {
        const USED: usize = 3;
        let widths = &self.color;
        let products: Vec<usize> = widths.windows(2).map(|pair| pair[0] * pair[1]).collect();
        let forward: usize = products.iter().sum();
        let (inputs, last) = (widths[0], widths[widths.len() - 2]);
        let left_out = (inputs - LANES) * widths[1] + (LANES - USED) * last;
        let net = drawn(Net::new(widths).carrying(USED, 1));
        (net, [forward, 2 * forward - left_out])
    }
}

/// Fills the weights with random numbers.
fn drawn(mut net: Net) -> Net {
    for layer in &mut net.layers {
        layer.weights = blocks(layer.weights.len(), 2);
        layer.refresh();
    }
    net
}

/// Every number has a gradient.
fn adam(field: &Field, level: InstructionSet, threads: &Threads, limits: &Limits, _peak: f64) -> [f64; 2] {
    let (fresh, bias) = (field.tables(), &Bias::default());
    let count: usize = fresh.iter().map(Vec::len).sum();
    let rate = threads.rate(|_| {
        let tables = fresh.iter().map(|fresh| {
            let (mut table, mut gradient) = (fresh.clone(), fresh.clone());
            let mut held = Moments::new(table.len(), field.features);
            let mut shortest = f64::MAX;
            for _ in 0..10 {
                gradient.clone_from(fresh);
                let (weights, gradient, moments) = (&mut table[..], &mut gradient[..], &mut held);
                let (rate, epsilon, decay) = (1e-2, 1e-12, 0.0);
                shortest = shortest.min(once(|| match field.features {
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
                }));
            }
            shortest
        });
        tables.sum()
    });
    [rate * count as f64 / 1e6, limits.triad * 1e3 / 32.0]
}

/// The samples of 16 rays.
fn composite(_: &Field, level: InstructionSet, threads: &Threads, _: &Limits, peak: f64) -> [f64; 2] {
    let count = 16 * RAY;
    let rate = threads.rate(|_| {
        let (raw, logits, delta) = (numbers(count, 7), blocks(count, 6), vec![0.01; count]);
        let place: Vec<f32> = (0..count).map(|k| (k % RAY) as f32 / RAY as f32).collect();
        let (mut tau, mut alpha, mut transmittance) = (raw.clone(), raw.clone(), raw.clone());
        let (mut rgb, mut d_tau, mut d_rgb) = (vec![[0.0; 4]; count], raw.clone(), vec![[0.0; 4]; count]);
        best(|| {
            let (tau, alpha) = (&mut tau[..], &mut alpha[..]);
            level.run(Depths {
                raw: &raw,
                delta: &delta,
                tau,
                alpha,
            });
            for (tau, before) in tau.chunks(RAY).zip(transmittance.chunks_mut(RAY)) {
                let mut depth = 0.0;
                for (tau, before) in tau.iter().zip(before) {
                    *before = depth;
                    depth += tau;
                }
            }
            level.run(ExpNeg(&mut transmittance));
            level.run(Colours {
                logits: &logits,
                rgb: &mut rgb,
            });
            for first in (0..count).step_by(RAY) {
                let span = first..first + RAY;
                let ray = Ray {
                    alpha: &alpha[span.clone()],
                    transmittance: &transmittance[span.clone()],
                    rgb: &rgb[span.clone()],
                    place: &place[span.clone()],
                };
                let slope = level.run(Gather(ray)).rgb;
                let (behind, distortion) = ([0.5; 3], [1e-3, 0.01]);
                let (d_tau, d_rgb) = (&mut d_tau[span.clone()], &mut d_rgb[span]);
                level.run(Spread {
                    ray,
                    slope,
                    behind,
                    distortion,
                    d_tau,
                    d_rgb,
                });
            }
        })
    });
    // Two exponentials for opacity and transmittance, one for density, four for colours: about 200 operations.
    [rate * count as f64 / 1e6, peak * 1e3 / 200.0]
}

/// Rays from everywhere through a shell of 1 cell in 40.
fn march(_: &Field, level: InstructionSet, threads: &Threads, _: &Limits, peak: f64) -> [f64; 2] {
    let (steps, mut bits) = (Steps::new(0.1, 512.0, 0.03, 0.04), Bits::new(128));
    for cell in 0..128_usize.pow(3) {
        let at = [cell % 128, cell / 128 % 128, cell / 128 / 128].map(|at| at as f32 - 63.5);
        let radius = at.iter().map(|at| at * at).sum::<f32>().sqrt();
        if (radius - 24.0).abs() < 3.0 {
            bits.set(cell);
        }
    }
    let (random, clearance) = (numbers(64 * 6, 9), Clearance::new(&bits));
    let rate = threads.rate(|_| {
        let mut samples = Samples::default();
        best(|| {
            samples.resize(0);
            for ray in random.chunks_exact(6) {
                let norm = ray[3..].iter().map(|part| part * part).sum::<f32>().sqrt();
                level.run(March {
                    clearance: Some(&clearance),
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
    });
    // About 40 operations a step.
    [rate * 64.0 / 1e6, peak * 1e3 / (40 * steps.count) as f64]
}
