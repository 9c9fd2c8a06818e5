//! Exposures against their twin on the CPU.

use bytemuck::Zeroable;
use marf_shaders::{Step, Target, counts, faults};

use super::Gpu;
use super::array::Array;
use super::exposures::{ExposureArrays, ExposureInputs, ExposurePasses, Exposures};
use super::testing::{gpu, worst};
use marf_field::batch::Chunk;
use marf_field::cpu::adam::Bias;
use marf_field::cpu::simd::InstructionSet;
use marf_field::exposure::Exposure;
use marf_field::learn::learn_exposures;
use marf_field::rng::{Purpose, random_numbers};
use marf_field::test_scene::{ball_view, small};
use marf_field::training::Training;
use marf_field::{Config, Gain};
use marf_numeric::Rng;

/// Of a gain after ten steps of 1e-3: sums of slopes and the mean are added in another order.
const GAIN: f32 = 1e-6;
/// Step size of the test.
const RATE: f32 = 1e-2;
/// First row of the slopes, and slots for rays.
const ROW: usize = 2;
const SLOTS: usize = 700;

struct Scene {
    arrays: ExposureArrays,
    counts: Array<u32>,
    targets: Array<Target>,
    slopes: Array<f32>,
    faults: Array<u32>,
    exposing: ExposurePasses,
}

fn scene(gpu: &Gpu, views: usize, gain: Gain) -> Scene {
    let arrays = ExposureArrays::new(gpu, views, gain, SLOTS, ROW).unwrap();
    let step = Step {
        rate: RATE,
        ..Step::zeroed()
    };
    let step = gpu.uniform("step", step).unwrap();
    let counts = gpu.zeros("counts", counts::LEN).unwrap();
    let targets = gpu.zeros("targets", SLOTS).unwrap();
    let slopes = gpu.zeros("slopes", (ROW + 6) * SLOTS).unwrap();
    let bias = gpu.filled("bias", Bias::default().corrections()).unwrap();
    let faults = gpu.zeros("faults", faults::LEN).unwrap();
    let inputs = ExposureInputs {
        step: &step,
        counts: &counts,
        targets: &targets,
        slopes: &slopes,
        bias: &bias,
        faults: &faults,
    };
    let exposing = Exposures::new(gpu).unwrap().bind(gpu, &arrays, inputs);
    Scene {
        arrays,
        counts,
        targets,
        slopes,
        faults,
        exposing,
    }
}

impl Scene {
    /// Writes rays in use and takes one step.
    fn learn(&self, gpu: &Gpu, rays: &[(u32, Exposure)]) {
        gpu.write(&self.counts, counts::RAYS as usize, &[rays.len() as u32]);
        let targets: Vec<_> = rays
            .iter()
            .map(|(view, _)| Target {
                view: *view,
                ..Target::zeroed()
            })
            .collect();
        gpu.write(&self.targets, 0, &targets);
        for row in 0..6 {
            let slope = |(_, slopes): &(u32, Exposure)| [slopes.gain, slopes.offset][row / 3][row % 3];
            let column: Vec<f32> = rays.iter().map(slope).collect();
            gpu.write(&self.slopes, (ROW + row) * SLOTS, &column);
        }
        gpu.submit(|recorder| {
            self.exposing.record_sums(recorder);
            self.exposing.record_learn(recorder);
        });
    }

    fn gains(&self, gpu: &Gpu) -> Vec<f32> {
        gpu.read(&self.arrays.gains).unwrap().into_flattened()
    }
}

/// Slopes of about `size`. The last view has no ray.
fn random_rays(count: usize, views: usize, rng: &mut Rng) -> Vec<(u32, Exposure)> {
    let mut number = || (rng.unit_f32() - 0.4) * 1e-3;
    let slopes: Vec<_> = (0..count)
        .map(|_| Exposure {
            gain: [0; 3].map(|_| number()),
            offset: [0; 3].map(|_| number()),
        })
        .collect();
    let others = (views as u64 - 1).max(1);
    slopes
        .into_iter()
        .map(|slope| (rng.below(others) as u32, slope))
        .collect()
}

fn training(views: usize, gain: Gain) -> Training {
    let views = (0..views).map(|view| ball_view(view as f64, 0.5, 2)).collect();
    Training::new(views, &[], &Config { gain, ..small() }, 1).unwrap()
}

#[test]
fn exposures_learn_what_the_cpu_learns() {
    let Some(gpu) = gpu("exposures_learn_what_the_cpu_learns") else {
        return;
    };
    let mut rng = random_numbers(1, Purpose::Rays, 0, 0);
    for (views, gain) in [
        (1, Gain::PerPhoto),
        (5, Gain::PerPhoto),
        (5, Gain::PerPhotoAndOffset),
        (300, Gain::PerPhotoAndOffset),
    ] {
        let (scene, mut training) = (scene(&gpu, views, gain), training(views, gain));
        for _ in 0..10 {
            let rays = random_rays(600, views, &mut rng);
            scene.learn(&gpu, &rays);
            let mut chunk = Chunk::default();
            chunk.found.exposures = rays;
            learn_exposures(InstructionSet::best(), &mut training, &[chunk], RATE);
        }
        let moments = &training.state.gain_moments;
        let flat = |array: &Array<[f32; 4]>| gpu.read(array).unwrap().into_flattened();
        let (apart, at) = worst(&scene.gains(&gpu), &training.state.gains);
        let (mean, _) = worst(&flat(&scene.arrays.mean), &moments.first);
        let (square, _) = worst(&flat(&scene.arrays.square), &moments.second);
        eprintln!("{views} views, {gain:?}: gains {apart:e}, mean {mean:e}, square {square:e}");
        assert!(apart < GAIN, "{views} {gain:?}: {apart} at {at}");
        assert!(mean < 1e-6 && square < 1e-7, "{mean} {square}");
        assert_eq!(gpu.read(&scene.arrays.count), Ok(moments.count.clone()));
        assert_eq!(gpu.read(&scene.faults), Ok(vec![0; faults::LEN]));
    }
}

#[test]
fn exposures_are_cut_and_lose_their_mean_as_on_the_cpu() {
    let Some(gpu) = gpu("exposures_are_cut_and_lose_their_mean_as_on_the_cpu") else {
        return;
    };
    let (scene, mut training) = (
        scene(&gpu, 3, Gain::PerPhotoAndOffset),
        training(3, Gain::PerPhotoAndOffset),
    );
    let wide = [3.0, -5.0, 0.25, 0.0];
    training.state.gains = [wide, [1.0; 4], [0.0; 4], wide, [-0.3; 4], [0.2; 4]].concat();
    gpu.write(&scene.arrays.gains, 0, training.state.gains.as_chunks::<4>().0);
    scene.learn(&gpu, &[]);
    learn_exposures(InstructionSet::best(), &mut training, &[Chunk::default()], RATE);
    let (apart, at) = worst(&scene.gains(&gpu), &training.state.gains);
    assert!(apart < GAIN, "{apart} at {at}");
}

#[test]
fn an_exposure_that_runs_away_is_a_fault_and_nothing_is_learnt() {
    let Some(gpu) = gpu("an_exposure_that_runs_away_is_a_fault_and_nothing_is_learnt") else {
        return;
    };
    let mut rng = random_numbers(2, Purpose::Rays, 0, 0);
    let fault = vec![0, 0, 0, 0, 0, 0, 1, 0];
    for bad in [f32::NAN, f32::INFINITY, -1.2e9, f32::from_bits(0xffc0_0001)] {
        let mut rays = random_rays(200, 4, &mut rng);
        rays[130].1.offset[2] = bad;
        let of_slope = scene(&gpu, 4, Gain::PerPhoto);
        of_slope.learn(&gpu, &rays);
        assert_eq!(gpu.read(&of_slope.faults), Ok(fault.clone()), "{bad}");
        assert_eq!(of_slope.gains(&gpu), [0.0; 16], "{bad}");
        // A ray that is not in use is not looked at.
        let unused = scene(&gpu, 4, Gain::PerPhoto);
        unused.learn(&gpu, &rays);
        gpu.write(&unused.faults, 0, &[0; faults::LEN]);
        unused.learn(&gpu, &rays[..130]);
        assert_eq!(gpu.read(&unused.faults), Ok(vec![0; faults::LEN]), "{bad}");
        assert_ne!(unused.gains(&gpu), [0.0; 16], "{bad}");
        let of_gain = scene(&gpu, 4, Gain::PerPhotoAndOffset);
        gpu.write(&of_gain.arrays.gains, 6, &[[0.0, bad, 0.0, 0.0]]);
        of_gain.learn(&gpu, &rays[..130]);
        assert_eq!(gpu.read(&of_gain.faults), Ok(fault.clone()), "{bad}");
    }
    // Another's fault stops learning, too.
    let stopped = scene(&gpu, 4, Gain::PerPhoto);
    gpu.write(&stopped.faults, 0, &[1]);
    stopped.learn(&gpu, &random_rays(200, 4, &mut rng));
    assert_eq!(stopped.gains(&gpu), [0.0; 16]);
}
