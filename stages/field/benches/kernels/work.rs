//! The kernels at 2^16 samples, as a training step runs them.

use std::fmt;
use std::hint::black_box;

use marf_field::cpu::adam::{Adam, Bias, Moments};
use marf_field::cpu::clearance::Clearance;
use marf_field::cpu::composite::{Colours, Depths, ExpNeg, Gather, Ray, Spread};
use marf_field::cpu::encode::{Lookup, Scatter, Shape};
use marf_field::cpu::march::{March, Samples, Steps};
use marf_field::cpu::net::{Layer, Net, Slopes};
use marf_field::cpu::simd::{InstructionSet, LANES, Run, Stripe};
use marf_field::cpu::space::Bits;
use marf_field::{Config, Facts};

use crate::ceilings;
use crate::clock::{Threads, best, once};
use crate::data::{RAY, blocks, numbers, points, samples, whole};

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
            "triad {triad:.1} GB/s, random rows {:.0} M/s read, {:.0} M/s added to",
            rows[0], rows[1]
        )
    }
}

impl Field {
    fn new(name: &'static str, config: &Config, shapes: Vec<Shape>) -> Self {
        let features = config.features as usize;
        let mut color = vec![32];
        color.extend((0..config.color_layers).map(|_| config.color_width as usize));
        color.push(16);
        Self {
            name,
            features,
            density: vec![shapes.len() * features, config.density_width as usize, 16],
            shapes,
            color,
        }
    }

    /// Returns a field whose levels have 16 to 2048 cells a side.
    fn graded(name: &'static str, config: &Config, levels: u32, log2_table: u32) -> Self {
        let growth = (2048_f64 / 16.0).powf(1.0 / f64::from(levels - 1));
        let side = |level: u32| (16.0 * growth.powi(level as i32)).round() as u32;
        let shapes = (0..levels).map(|level| Shape::new(side(level), log2_table));
        Self::new(name, config, shapes.collect())
    }

    pub fn fixed() -> Self {
        Self::graded("fixed", &Config::fixed(), 16, 19)
    }

    pub fn default() -> Self {
        Self::graded("default", &Config::default(), 8, 15)
    }

    /// Returns the shape of a field that was trained.
    pub fn from_facts(facts: &Facts, config: &Config) -> Self {
        let log2_table = facts.sizes.log2_table.value;
        let shapes = facts
            .levels
            .iter()
            .map(|level| Shape::new(level.resolution, log2_table));
        Self::new("trained", config, shapes.collect())
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

/// A network, and the products that a sample takes.
struct NetWork {
    net: Net,
    forward: usize,
    backward: usize,
}

/// One chunk of samples again and again, as many as training takes at once.
fn network(
    work: &NetWork,
    level: InstructionSet,
    threads: &Threads,
    peak: f64,
    direction: Direction,
) -> [f64; 2] {
    let NetWork {
        net,
        forward,
        backward,
    } = work;
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
        let mut back = Slopes::default();
        best(|| {
            net.forward(level, &input, &mut activations);
            if direction == Direction::Both {
                back.rows.clone_from(&slopes);
                net.backward(level, &input, &activations, &mut back, &mut gradients);
            }
        })
    });
    let sums = if direction == Direction::Both {
        forward + backward
    } else {
        *forward
    };
    [rate * CHUNK as f64 / 1e6, peak * 1e3 / (2 * sums) as f64]
}

impl Field {
    /// The density network, and the products a sample forward and backward.
    fn density_net(&self) -> NetWork {
        let forward: usize = self.density.windows(2).map(|pair| pair[0] * pair[1]).sum();
        NetWork {
            net: drawn(Net::new(&self.density)),
            forward,
            backward: 2 * forward,
        }
    }

    /// The colour network: gradients of 3 of its outputs, carried back to the first 16 inputs.
    fn color_net(&self) -> NetWork {
        const USED: usize = 3;
        let widths = &self.color;
        let products: Vec<usize> = widths.windows(2).map(|pair| pair[0] * pair[1]).collect();
        let forward: usize = products.iter().sum();
        let (inputs, last) = (widths[0], widths[widths.len() - 2]);
        let left_out = (inputs - LANES) * widths[1] + (LANES - USED) * last;
        NetWork {
            net: drawn(Net::new(widths).carrying(USED, 1)),
            forward,
            backward: 2 * forward - left_out,
        }
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
