//! Networks against their twins on the CPU.

use marf_shaders::{counts, faults};

use super::array::Array;
use super::batch::BatchSize;
use super::nets::{BACKGROUND, Back, KeptSamples, Layers, Nets, Rows};
use super::order::GROUPS;
use super::rig::{Rig, UNTOUCHED, agree, columns, is_untouched};
use super::testing::numbers;
use marf_field::Background;
use marf_field::sh;

/// Rounding through six layers and back, as a share of the largest number.
const CHAIN: f32 = 1e-5;

fn layers(widths: [usize; 3], hidden: usize, directed: usize) -> Layers {
    let [features, density, color] = widths;
    let mut shapes = vec![[features, density], [density, 16], [16 + directed, color]];
    shapes.extend((1..hidden).map(|_| [color, color]));
    shapes.push([color, 16]);
    Layers { shapes, density: 2 }
}

/// Fields of all widths: tiles of 64 and of 32 samples, one to three hidden layers, with and without directions.
fn fields() -> [Layers; 4] {
    [
        layers([32, 64, 64], 2, 16),
        layers([16, 16, 32], 1, 16),
        layers([48, 32, 128], 3, 16),
        layers([16, 128, 16], 1, 0),
    ]
}

/// Samples, their slopes, and what is true of them in f64.
struct Case {
    layers: Layers,
    weights: Vec<f32>,
    /// `[visited][inputs]`.
    features: Vec<f32>,
    origin: Vec<u32>,
    ray_of: Vec<u32>,
    directions: Vec<[f32; 4]>,
    /// `[kept][4]`: slope in the raw density, slopes in the logits.
    heads: Vec<f32>,
}

/// What the twin finds.
struct Expected {
    /// `[visited][16]`.
    latent: Vec<f32>,
    /// `[kept][3]`.
    logits: Vec<f32>,
    gradient: Vec<f32>,
    /// `[kept][inputs]`.
    slopes: Vec<f32>,
}

const RAYS: usize = 64;

impl Case {
    /// `kept` kept samples: every other visited one.
    fn new(layers: Layers, kept: usize) -> Self {
        let inputs = layers.shapes[0][0];
        let directions = numbers(3 * RAYS, 3);
        let rays = directions.chunks(3).enumerate().map(|(ray, at)| {
            let length = at.iter().map(|x| x * x).sum::<f32>().sqrt();
            let there = f32::from(ray % 7 != 3);
            [at[0] / length, at[1] / length, at[2] / length, there]
        });
        Self {
            weights: numbers(layers.numbers(), 1).iter().map(|x| 0.3 * x).collect(),
            features: numbers(2 * kept * inputs, 2),
            origin: (0..kept as u32).map(|sample| 2 * sample + 1).collect(),
            ray_of: (0..2 * kept as u32)
                .map(|sample| sample / 10 % RAYS as u32)
                .collect(),
            directions: rays.collect(),
            heads: numbers(4 * kept, 4),
            layers,
        }
    }

    /// One layer in f64, forward.
    fn ahead(&self, number: usize, input: &[f64]) -> Vec<f64> {
        let ([_, outputs], first) = (self.layers.shapes[number], self.layers.firsts()[number]);
        let mut sums = vec![0.0; outputs];
        for (x, row) in input.iter().zip(self.weights[first..].chunks(outputs)) {
            let terms = sums.iter_mut().zip(row);
            terms.for_each(|(sum, weight)| *sum += x * f64::from(*weight));
        }
        sums
    }

    /// The inputs of all layers of a kept sample, and its logits.
    fn inputs(&self, visited: usize, direction: Option<[f32; 4]>) -> Vec<Vec<f64>> {
        let width = self.layers.shapes[0][0];
        let features = self.features[visited * width..][..width].iter();
        let mut all = vec![features.map(|x| f64::from(*x)).collect::<Vec<_>>()];
        for number in 0..self.layers.shapes.len() {
            let mut next = self.ahead(number, &all[number]);
            if number + 1 == self.layers.density {
                let harmonics = match direction {
                    Some([x, y, z, 1.0]) => sh::harmonics([x, y, z]),
                    _ => [0.0; sh::COUNT],
                };
                if self.layers.shapes[number + 1][0] > 16 {
                    next.extend(harmonics.map(f64::from));
                }
            } else if number + 1 < self.layers.shapes.len() {
                next.iter_mut().for_each(|x| *x = x.max(0.0));
            }
            all.push(next);
        }
        all
    }

    fn expected(&self) -> Expected {
        let width = self.layers.shapes[0][0];
        let mut gradient = vec![0.0_f64; self.layers.weights()];
        let (mut logits, mut slopes) = (Vec::new(), Vec::new());
        for (sample, visited) in self.origin.iter().enumerate() {
            let direction = self.directions[self.ray_of[*visited as usize] as usize];
            let inputs = self.inputs(*visited as usize, Some(direction));
            let heads: Vec<f64> = self.heads[4 * sample..][..4]
                .iter()
                .map(|x| f64::from(*x))
                .collect();
            logits.extend(inputs[self.layers.shapes.len()][..3].iter().map(|x| *x as f32));
            let mut slope = vec![0.0; 16];
            slope[..3].copy_from_slice(&heads[1..]);
            for number in (0..self.layers.shapes.len()).rev() {
                let ([rows, outputs], first) = (self.layers.shapes[number], self.layers.firsts()[number]);
                let mut below = vec![0.0; rows];
                for row in 0..rows {
                    let at = first + row * outputs;
                    for column in 0..outputs {
                        gradient[at + column] += inputs[number][row] * slope[column];
                        below[row] += f64::from(self.weights[at + column]) * slope[column];
                    }
                    let is_hidden = number != 0 && number != self.layers.density;
                    if is_hidden && inputs[number][row] <= 0.0 {
                        below[row] = 0.0;
                    }
                }
                if number == self.layers.density {
                    below.truncate(16);
                    below[0] += heads[0];
                }
                slope = below;
            }
            slopes.extend(slope.iter().map(|x| *x as f32));
        }
        let visited = 0..self.features.len() / width;
        let latent = visited.flat_map(|sample| self.inputs(sample, None)[2][..16].to_vec());
        Expected {
            latent: latent.map(|x| x as f32).collect(),
            logits,
            gradient: gradient.iter().map(|x| *x as f32).collect(),
            slopes,
        }
    }
}

/// What the device finds.
struct Found {
    latent: Vec<f32>,
    colours: Vec<f32>,
    gradient: Vec<f32>,
    slopes: Vec<f32>,
    faults: Vec<u32>,
}

/// Runs both networks forward and back. Garbage follows the samples in use.
fn run(test: &str, case: &Case, capacity: usize) -> Option<Found> {
    let (kept, inputs) = (case.origin.len(), case.layers.shapes[0][0]);
    let visited = case.features.len() / inputs;
    let size = BatchSize {
        samples: capacity,
        rays: RAYS,
    };
    let rig = Rig::new(test, size, [visited as u32, kept as u32, RAYS as u32])?;
    let (gpu, batch) = (&rig.gpu, rig.batch());
    let nets = Nets::new(gpu, &case.layers).unwrap();
    let words = |values: &[u32]| {
        let mut all = values.to_vec();
        all.resize(capacity, 3);
        gpu.filled("words", &all).unwrap()
    };
    let (origin, ray_of) = (words(&case.origin), words(&case.ray_of));
    let directions = gpu.filled("directions", &case.directions).unwrap();
    let seen = KeptSamples {
        origin: &origin,
        ray_of: &ray_of,
        directions: &directions,
    };
    let (weights, features) = (
        rig.filled(&case.weights),
        rig.filled(&columns(&case.features, inputs, capacity, f32::NAN)),
    );
    let mut heads = columns(&case.heads, 4, capacity, f32::NAN);
    // The slope in the raw density comes last.
    heads.rotate_left(capacity);
    let d_outputs = rig.filled(&heads);
    let (latent, colours, slopes) = (rig.untouched(16), rig.untouched(6), rig.untouched(inputs));
    let work = rig.filled(&vec![f32::NAN; case.layers.work(capacity, RAYS)]);
    let gradient = rig.filled(&vec![UNTOUCHED; case.layers.numbers()]);
    let back = Back {
        features: &features,
        seen,
        weights: &weights,
        d_outputs: &d_outputs,
        work: &work,
        slopes: &slopes,
    };
    let runs = [
        nets.density(batch, &weights, &features, &latent, Rows::All)
            .unwrap(),
        nets.shade(batch, &weights, seen, &latent, &colours).unwrap(),
        nets.back(batch, back).unwrap(),
        nets.sum(batch, Background::Black, &work, &gradient).unwrap(),
    ];
    gpu.submit(|recorder| runs.iter().for_each(|run| run.record(recorder)));
    let read = |array: &Array<f32>| gpu.read(array).unwrap();
    Some(Found {
        latent: read(&latent),
        colours: read(&colours),
        gradient: read(&gradient),
        slopes: read(&slopes),
        faults: rig.faulty(),
    })
}

/// The samples in use of columns.
fn in_use(columns: &[f32], capacity: usize, samples: usize) -> Vec<f32> {
    let columns = columns.chunks(capacity);
    columns.flat_map(|column| &column[..samples]).copied().collect()
}

#[test]
fn networks_forward_and_back_are_those_of_f64_in_every_shape() {
    let test = "networks_forward_and_back_are_those_of_f64_in_every_shape";
    for (layers, kept) in fields().into_iter().zip([301, 64, 131, 3]) {
        let (case, capacity) = (Case::new(layers, kept), 1024);
        let Some(found) = run(test, &case, capacity) else {
            return;
        };
        let (expected, inputs) = (case.expected(), case.layers.shapes[0][0]);
        let rows =
            |rows: &[f32], width, samples| in_use(&columns(rows, width, capacity, 0.0), capacity, samples);
        let name = format!("{:?}", case.layers.shapes);
        let latent = rows(&expected.latent, 16, 2 * kept);
        agree(
            &format!("latent {name}"),
            &in_use(&found.latent, capacity, 2 * kept),
            &latent,
            CHAIN,
        );
        let logits = rows(&expected.logits, 3, kept);
        agree(
            &format!("logits {name}"),
            &in_use(&found.colours[3 * capacity..], capacity, kept),
            &logits,
            CHAIN,
        );
        let sigmoid: Vec<f32> = logits.iter().map(|x| 1.0 / (1.0 + (-x).exp())).collect();
        agree(
            &format!("colours {name}"),
            &in_use(&found.colours[..3 * capacity], capacity, kept),
            &sigmoid,
            CHAIN,
        );
        let slopes = rows(&expected.slopes, inputs, kept);
        agree(
            &format!("slopes {name}"),
            &in_use(&found.slopes, capacity, kept),
            &slopes,
            CHAIN,
        );
        let weights = case.layers.weights();
        agree(
            &format!("gradient {name}"),
            &found.gradient[..weights],
            &expected.gradient,
            CHAIN,
        );
        assert!(found.gradient[weights..].iter().all(is_untouched));
        assert!(found.faults.is_empty());
        // Tiles without samples are not written.
        let behind = (2 * kept).next_multiple_of(case.layers.tile());
        let mut rest = found.latent.chunks(capacity).flat_map(|row| &row[behind..]);
        assert!(rest.all(is_untouched), "{name}");
    }
}

#[test]
fn more_tiles_than_workgroups_are_all_added_and_none_gives_zero() {
    let test = "more_tiles_than_workgroups_are_all_added_and_none_gives_zero";
    for kept in [26_000, 0] {
        let case = Case::new(layers([16, 128, 16], 1, 0), kept);
        let tiles = kept.div_ceil(case.layers.tile());
        assert!(kept == 0 || tiles > GROUPS, "{tiles} tiles: none is a second one");
        let Some(found) = run(test, &case, 52_224) else {
            return;
        };
        let weights = case.layers.weights();
        agree(
            "gradient",
            &found.gradient[..weights],
            &case.expected().gradient,
            CHAIN,
        );
        assert!(kept > 0 || found.slopes.iter().chain(&found.colours).all(is_untouched));
    }
}

#[test]
fn workgroups_of_wide_layers_are_fewer_so_that_a_binding_holds_them() {
    for width in [16, 64, 128, 512] {
        let layers = layers([width; 3], 3, width);
        let numbers = layers.work(1 << 20, 1 << 18);
        assert!(4 * numbers <= 128 << 20, "{width}: {numbers} numbers");
        assert!(layers.behind(1 << 20) > 0, "{width}: no workgroup");
    }
}

/// Drivers may make a comparison with 0 a maximum, which takes NaN for the smaller.
#[test]
fn a_relu_passes_nan_and_infinity_on_to_their_own_sample() {
    let test = "a_relu_passes_nan_and_infinity_on_to_their_own_sample";
    let mut case = Case::new(layers([16, 32, 16], 1, 0), 8);
    case.weights.fill(0.5);
    case.features.fill(1.0);
    case.features[16] = f32::NAN;
    case.features[2 * 16] = f32::INFINITY;
    case.features[3 * 16..4 * 16].fill(f32::NEG_INFINITY);
    case.features[5 * 16] = -f32::NAN;
    let Some(found) = run(test, &case, 256) else {
        return;
    };
    let [first, nan, infinite, none, _, other] = [0, 1, 2, 3, 4, 5].map(|sample| found.latent[sample]);
    assert!(nan.is_nan() && other.is_nan(), "{:?}", &found.latent[..8]);
    assert_eq!((first, infinite, none), (128.0, f32::INFINITY, 0.0));
    assert!(found.faults.contains(&faults::LOGITS));
}

#[test]
fn slopes_and_sums_that_run_away_are_told() {
    let test = "slopes_and_sums_that_run_away_are_told";
    for bad in [1e20, f32::NAN, f32::INFINITY] {
        let mut case = Case::new(layers([16, 32, 32], 1, 16), 70);
        case.heads[4 * 66 + 2] = bad;
        let Some(found) = run(test, &case, 256) else {
            return;
        };
        assert_eq!(found.faults, [faults::FEATURES, faults::NETWORKS], "{bad}");
    }
}

/// The twin of `sum`: parts in 16 slices, which then are added by halves.
fn summed(parts: &[Vec<f32>]) -> Vec<f32> {
    let mut slices = vec![vec![0.0_f32; parts[0].len()]; 16];
    for (number, part) in parts.iter().enumerate() {
        let sums = slices[number % 16].iter_mut();
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
fn parts_are_added_in_one_order() {
    let layers = layers([16, 16, 16], 1, 0);
    let (capacity, rays) = (4096, 640);
    let size = BatchSize {
        samples: capacity,
        rays,
    };
    let most = capacity / layers.tile();
    for (kept, chunks) in [(2300, 3), (4096, 10)] {
        let groups = (kept as usize).div_ceil(layers.tile());
        let in_use = [0, kept, if chunks == 3 { 130 } else { 640 }];
        let Some(rig) = Rig::new("parts_are_added_in_one_order", size, in_use) else {
            return;
        };
        let work = numbers(layers.work(capacity, rays), 5);
        let stride = (work.len() - rays / 64 * BACKGROUND) / most;
        let nets = Nets::new(&rig.gpu, &layers).unwrap();
        let (parts, found) = (rig.filled(&work), rig.filled(&vec![UNTOUCHED; layers.numbers()]));
        let run = nets.sum(rig.batch(), Background::Direction, &parts, &found);
        rig.gpu.submit(|recorder| run.unwrap().record(recorder));
        let part = |first: usize, len: usize| work[first..first + len].to_vec();
        let nets: Vec<_> = (0..groups)
            .map(|group| part(group * stride, layers.weights()))
            .collect();
        let rays: Vec<_> = (0..chunks)
            .map(|chunk| part(most * stride + chunk * BACKGROUND, BACKGROUND))
            .collect();
        let expected = [summed(&nets), summed(&rays)].concat();
        assert!(rig.gpu.read(&found).unwrap() == expected, "{kept}");
        assert!(rig.gpu.read(&rig.counts).unwrap()[counts::KEPT as usize] == kept);
    }
}
