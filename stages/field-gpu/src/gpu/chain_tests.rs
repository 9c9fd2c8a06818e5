//! A whole batch from features to gradients against the CPU, and against differences in f64.

use marf_shaders::found;

use super::batch::BatchSize;
use super::chain_device::on_the_device;
use super::chain_f64::loss;
use super::rig::{Rig, agree, columns};
use super::testing::{numbers, worst};
use marf_field::Config;
use marf_field::batch::{Chunk, Spares, StepContext, train};
use marf_field::cpu::clearance::Clearance;
use marf_field::cpu::composite::OPAQUE;
use marf_field::cpu::march::March;
use marf_field::cpu::simd::{InstructionSet, Run, flat};
use marf_field::depth::Pull;
use marf_field::draw::{Behind, Target};
use marf_field::exposure::Exposure;
use marf_field::shade::{Shade, Span};
use marf_field::test_scene::{ball, small};
use marf_field::training::Training;

pub const CAPACITY: usize = 4096;
pub const SLOTS: usize = 64;
/// Slots of both.
pub const SIZE: BatchSize = BatchSize {
    samples: CAPACITY,
    rays: SLOTS,
};
pub const RAYS: usize = 33;
const NO_RAY: usize = 9;
/// Rounding in some hundred operations one after the other, as a share of the largest number.
const CHAIN: f32 = 1e-5;

/// A field that is not yet trained but has something to see, and rays.
pub fn scene(ray_samples: u32) -> (Training, Vec<Target>) {
    let config = Config {
        ray_samples,
        density_width: 32,
        color_width: 32,
        color_layers: 2,
        distortion: Some(1e-2),
        emptiness: 1e-3,
        ..small()
    };
    let mut training = Training::new(ball(3, 16), &[], &config, 7).unwrap();
    for (level, table) in training.state.weights.tables.iter_mut().enumerate() {
        let values = numbers(table.len(), 50 + level as u64);
        table
            .iter_mut()
            .zip(values)
            .for_each(|(entry, value)| *entry = 25.0 * value);
    }
    let targets = (0..RAYS).map(|ray| target(&training, ray)).collect();
    (training, targets)
}

fn target(training: &Training, ray: usize) -> Target {
    let view = &training.views[ray % 3];
    let (centre, rgb) = view.image.at(ray * 37 % view.image.count());
    let start = training
        .frame
        .ray(&view.camera, &view.cam_from_world.inverse(), centre);
    let pull = Pull {
        // Every second is of sky.
        place: if ray.is_multiple_of(8) { 2.0 } else { 0.3 },
        weight: 0.02,
    };
    Target {
        start: start.filter(|_| ray != NO_RAY),
        jitter: 0.25,
        view: (ray % 3) as u32,
        rgb,
        exposure: Exposure {
            gain: [1.0; 3],
            offset: [0.0; 3],
        },
        pull: ray.is_multiple_of(4).then_some(pull),
        // Over the background, or over a colour of its own.
        behind: ray.is_multiple_of(5).then_some(Behind {
            rgb: [0.9, 0.1, 0.4],
            share: 0.3,
        }),
    }
}

/// All samples of the rays, encoded.
pub fn visited(training: &Training, targets: &[Target]) -> (Shade, Vec<Span>) {
    let (mut shade, mut spans) = (Shade::default(), Vec::new());
    for target in targets {
        let first = shade.samples.len();
        if let Some(start) = target.start {
            InstructionSet::best().run(March {
                clearance: None,
                steps: &training.march,
                bits: &training.state.occupancy.bits,
                origin: start.origin,
                direction: start.direction,
                jitter: target.jitter,
                first: 0,
                limit: usize::MAX,
                samples: &mut shade.samples,
            });
        }
        let end = shade.samples.len();
        spans.push(Span { first, end });
    }
    shade.densities(InstructionSet::best(), &training.state.weights);
    (shade, spans)
}

/// The CPU's transmittances in front of all samples of the rays.
fn transmittances(training: &Training, targets: &[Target]) -> Vec<f32> {
    let (mut shade, spans) = visited(training, targets);
    shade.opacities(InstructionSet::best(), &spans, &vec![0.0; spans.len()]);
    shade.transmittance.to_vec()
}

/// The CPU's gradients. The chunk holds those of the features, too.
fn on_the_cpu(training: &Training, targets: &[Target]) -> Chunk {
    let shared = StepContext {
        level: InstructionSet::best(),
        config: &training.config,
        weights: &training.state.weights,
        steps: &training.march,
        bits: &training.state.occupancy.bits,
        clearance: &Clearance::new(&training.state.occupancy.bits),
        rays: targets.len(),
        ray_samples: training.config.ray_samples,
        distortion: training.distortion_at(training.state.steps),
    };
    let mut chunks = Vec::new();
    train(&shared, targets, targets.len(), &mut chunks, &Spares::default());
    chunks.pop().unwrap()
}

#[test]
fn a_batch_has_the_gradients_of_the_cpu() {
    compared("a_batch_has_the_gradients_of_the_cpu", 0);
}

#[test]
fn a_batch_of_chosen_samples_has_the_gradients_of_the_cpu() {
    compared("a_batch_of_chosen_samples_has_the_gradients_of_the_cpu", 6);
}

fn compared(test: &str, ray_samples: u32) {
    let Some(rig) = Rig::new(test, SIZE, [0; 3]) else {
        return;
    };
    let (training, targets) = scene(ray_samples);
    let here = on_the_device(&rig, &training, &targets);
    let there = on_the_cpu(&training, &targets);
    let expected = &there.found;
    assert_eq!((expected.bad, here.total.faults), (None, 0));
    let left = transmittances(&training, &targets);
    let close = left.iter().map(|left| (left / OPAQUE - 1.0).abs());
    let closest = close.fold(f32::INFINITY, f32::min);
    // No transmittance is so close to the limit of showing that a driver's rounding decides.
    assert!(closest > 1e-5, "{closest}");
    assert_eq!(here.kept as u64, expected.samples);
    assert!(
        expected.samples + 20 < expected.visited,
        "{} kept",
        expected.samples
    );
    for (layer, gradient) in here.found.density.iter().enumerate() {
        agree(
            &format!("density {layer}"),
            flat(gradient),
            flat(&expected.density[layer]),
            CHAIN,
        );
    }
    for (layer, gradient) in here.found.color.iter().enumerate() {
        agree(
            &format!("colour {layer}"),
            flat(gradient),
            flat(&expected.color[layer]),
            CHAIN,
        );
    }
    agree(
        "background",
        &here.found.background[..48],
        &expected.background,
        CHAIN,
    );
    let width = training.state.weights.row_blocks() * 16;
    // The CPU has them level by level, `[levels, n, F]`, the device a column a number.
    let planes = flat(&there.features);
    let (samples, features) = (planes.len() / width, training.state.weights.features);
    let number = |sample: usize, column: usize| {
        let (level, feature) = (column / features, column % features);
        planes[(level * samples + sample) * features + feature]
    };
    let rows: Vec<f32> = (0..here.kept)
        .flat_map(|sample| (0..width).map(move |column| (sample, column)))
        .map(|(sample, column)| number(sample, column))
        .collect();
    let rows = columns(&rows, width, CAPACITY, 0.0);
    let pairs = here.features.chunks(CAPACITY).zip(rows.chunks(CAPACITY));
    let (found, wanted): (Vec<_>, Vec<_>) = pairs
        .map(|(found, wanted)| (&found[..here.kept], &wanted[..here.kept]))
        .unzip();
    agree("features", &found.concat(), &wanted.concat()[..], CHAIN);
    let rays = (0..RAYS).filter(|ray| *ray != NO_RAY).zip(&expected.exposures);
    for (ray, (_, slopes)) in rays {
        let row = |row: usize| here.rows[row * SLOTS + ray];
        let gain = [0, 1, 2].map(|channel| row(found::GAIN + channel));
        let offset = [0, 1, 2].map(|channel| row(found::OFFSET + channel));
        assert!(
            worst(&gain, &slopes.gain).0 < CHAIN && worst(&offset, &slopes.offset).0 < CHAIN,
            "{ray}"
        );
    }
    let loss = f64::from(here.total.loss);
    assert!(
        (loss - expected.loss).abs() < 1e-5 * expected.loss,
        "{loss} against {}",
        expected.loss
    );
}

#[test]
fn a_batch_has_the_slopes_of_its_f64_twin() {
    let test = "a_batch_has_the_slopes_of_its_f64_twin";
    let Some(rig) = Rig::new(test, SIZE, [0; 3]) else {
        return;
    };
    let (training, targets) = scene(0);
    let here = on_the_device(&rig, &training, &targets).found;
    let slope = |tensor: usize, at: usize| {
        let moved = |by: f64| loss(&training, &targets, tensor, at, by);
        (moved(1e-6) - moved(-1e-6)) / 2e-6
    };
    let layers: Vec<&[f32]> = here
        .density
        .iter()
        .chain(&here.color)
        .map(|layer| flat(layer))
        .collect();
    for (tensor, gradient) in layers.into_iter().enumerate() {
        let size = gradient.iter().fold(0.0_f32, |size, x| size.max(x.abs()));
        let largest = gradient.iter().position(|x| x.abs() == size).unwrap_or(0);
        for at in [largest, 17] {
            let (found, expected) = (gradient[at], slope(tensor, at));
            let error = (f64::from(found) - expected).abs() / f64::from(size);
            println!("tensor {tensor}, {at}: {found} against {expected}, {error:.1e} of the largest");
            // Of some hundred thousand units a few cross the kink of a ReLU between the two values.
            assert!(error < 1e-5, "tensor {tensor}, {at}: {found} against {expected}");
        }
    }
}
