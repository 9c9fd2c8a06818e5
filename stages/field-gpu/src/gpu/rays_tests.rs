//! Random streams, drawn rays and rays of a picture against their twins.

use marf_scene::{Camera, Image, Pose};
use marf_shaders::{PixelRange, RNG, Shader};
use nalgebra::{Vector2, Vector3};

use super::Gpu;
use super::array::halves;
use super::rays::{DrawRays, Photos, Progress, RayArrays, ViewRays, camera, observed};
use super::testing::{aim, gpu, own_gpu};
use marf_field::draw::Target;
use marf_field::frame::{Frame, RayStart};
use marf_field::rng::{Purpose, random_numbers};
use marf_field::test_scene::small;
use marf_field::training::Training;
use marf_field::{Config, GpuError, PixelDistance, Pixels, View};

/// Of a direction, where the distortion moves a pixel by no more than an ideal camera: f32 rounds its terms.
const DIRECTION: f64 = 2e-6;
/// Distance from the fold, in focal lengths, within which the camera may judge otherwise whether a pixel is
/// beyond it.
const AT_THE_FOLD: f64 = 2e-5;

const STREAMS: Shader = Shader {
    name: "streams",
    shared: &[RNG],
    text: "
@group(0) @binding(0) var<storage, read> asked: array<vec2<u32>>;
@group(0) @binding(1) var<storage, read_write> found: array<vec2<u32>>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let k = 4u * id.x;
    if k >= arrayLength(&asked) { return; }
    var rng = rng_new(asked[k], asked[k].x % 4u + 1u, asked[k + 1u], asked[k + 2u]);
    found[k] = rng_bits(&rng);
    found[k + 1u] = rng_below(&rng, asked[k + 3u]);
    found[k + 2u] = vec2(bitcast<u32>(rng_unit(&rng)), 0u);
    found[k + 3u] = rng_bits(&rng);
}",
    heads: &[],
};

/// Seeds, steps, indices and bounds: every pair of extremes, then random ones.
fn asked() -> Vec<[u64; 4]> {
    let ends = [0, 1, u64::from(u32::MAX), 1 << 32, 1 << 63, u64::MAX];
    let mut asked = Vec::new();
    for (one, two) in ends.iter().flat_map(|one| ends.map(|two| (*one, two))) {
        asked.push([one, two, two, one]);
        asked.push([two, one, two, one]);
    }
    let mut rng = random_numbers(5, Purpose::Rays, 0, 0);
    asked.extend((0..2000).map(|k| [rng.bits(), rng.bits() >> (k % 64), k, rng.bits() >> (k % 61)]));
    asked
}

#[test]
fn streams_of_random_numbers_are_equal_bit_for_bit() {
    let Some(gpu) = gpu("streams_of_random_numbers_are_equal_bit_for_bit") else {
        return;
    };
    let asked = asked();
    let words: Vec<[u32; 2]> = asked.iter().flatten().map(|word| halves(*word)).collect();
    let input = gpu.filled("asked", &words).unwrap();
    let output = gpu.zeros::<[u32; 2]>("found", words.len()).unwrap();
    let bound = gpu.bind(
        &gpu.kernel(&STREAMS, "").unwrap(),
        &[(&input).into(), (&output).into()],
    );
    gpu.submit(|recorder| recorder.threads(&bound, asked.len()));
    let found = gpu.read(&output).unwrap();
    for ([seed, step, index, n], found) in asked.into_iter().zip(found.as_chunks::<4>().0) {
        let purpose = match seed as u32 % 4 {
            0 => Purpose::Tables,
            1 => Purpose::Networks,
            2 => Purpose::Rays,
            _ => Purpose::Occupancy,
        };
        let mut rng = random_numbers(seed, purpose, step, index);
        let bits = halves(rng.bits());
        let below = halves(rng.below(n));
        let expected = [bits, below, [rng.unit_f32().to_bits(), 0], halves(rng.bits())];
        assert_eq!(*found, expected, "{seed} {step} {index} {n}");
    }
}

/// The mock-up's distortion, and one that folds over within the photo.
fn lenses() -> [Camera; 2] {
    let rover = Camera {
        k1: 0.0943,
        k2: -0.1314,
        p1: 0.00125,
        p2: -0.00007,
        cx_px: 23.4,
        cy_px: 33.1,
        ..Camera::pinhole(48, 64, 48.4)
    };
    let folded = Camera {
        k1: -0.4,
        p1: 0.002,
        p2: -0.003,
        ..Camera::pinhole(64, 50, 40.0)
    };
    [rover, folded]
}

/// A photo with one pixel in `run` kept, with transparency or without.
fn view(camera: Camera, angle: f64, run: u32, is_opaque: bool) -> View {
    let eye = Vector3::new(30.0 + 3.0 * angle.cos(), 3.0 * angle.sin(), 0.7);
    let image = Image::from_fn(camera.width, camera.height, |column, row| {
        [(5 * column) as u8, (3 * row) as u8, (column * row) as u8]
    });
    // A mask over the left half of every photo: of the rays 1/256 still fall into it after all draws.
    let hidden: Vec<bool> = (0..camera.width * camera.height)
        .map(|place| place % camera.width < camera.width / 2)
        .collect();
    let all = (camera.width * camera.height) as usize;
    let alpha: Vec<u8> = (0..if is_opaque { 0 } else { all })
        .map(|place| (3 * place) as u8)
        .collect();
    // Of less and less sure ones, some pull with less than the whole weight. Every fifth is sky.
    let distances = (0..camera.height).map(|row| PixelDistance {
        pixel: [camera.width - 1 - row % 3, row],
        distance: if row % 5 == 0 { f32::INFINITY } else { 3.0 },
        sigma: 0.05 * row as f32,
    });
    View {
        id: format!("view {angle}"),
        camera,
        cam_from_world: Pose::looking_at(eye, Vector3::new(30.0, 0.0, 0.0), -Vector3::z()),
        image: Pixels::thinned(image, Some(&hidden), run, 3, run.into()).with_alpha(&alpha),
        distances: distances.collect(),
    }
}

fn training() -> Training {
    let [rover, folded] = lenses();
    let views = vec![
        view(rover, 0.0, 1, false),
        view(folded, 2.0, 1, true),
        view(rover, 4.0, 8, false),
    ];
    let points: Vec<[f64; 3]> = (0..60)
        .map(|k| {
            let k = f64::from(k);
            [30.0 + (k * 0.7).sin(), (k * 1.3).cos(), (k * 2.1).sin()]
        })
        .collect();
    let config = Config {
        depth_weight: 0.05,
        depth_steps: Some(1000),
        ..small()
    };
    Training::new(views, &points, &config, 0x9876_5432_1012_3456).unwrap()
}

/// How much farther than in an ideal camera a direction moves with its pixel. Infinite at the fold.
fn spread(camera: &Camera, pixel: [f64; 2]) -> f64 {
    let at = |x: f64, y: f64| camera.unproject(&Vector2::new(pixel[0] + x, pixel[1] + y));
    let by = 1e-3;
    let moved = |x: f64, y: f64| match (at(0.0, 0.0), at(x, y)) {
        (Some(here), Some(there)) => (there - here).norm() * camera.fx_px / by,
        _ => f64::INFINITY,
    };
    moved(by, 0.0).max(moved(0.0, by)).max(1.0)
}

/// The pixel is so near to the fold that f32 may take it for one beyond.
fn at_the_fold(camera: &Camera, pixel: [f64; 2]) -> bool {
    let by = AT_THE_FOLD * camera.fx_px;
    let there = |x: f64, y: f64| {
        camera
            .unproject(&Vector2::new(pixel[0] + x, pixel[1] + y))
            .is_some()
    };
    let around = [[by, 0.0], [-by, 0.0], [0.0, by], [0.0, -by]];
    around.iter().any(|[x, y]| there(*x, *y) != there(0.0, 0.0))
}

/// What the slots of targets hold at first.
const UNTOUCHED: marf_shaders::Target = marf_shaders::Target {
    rgb: [7.0; 3],
    view: 7,
    behind: [7.0; 3],
    share: 7.0,
};

/// Compares a ray with its twin and returns the error of its direction, in units of the tolerance.
fn apart(
    camera: &Camera,
    pixel: [f64; 2],
    start: Option<RayStart>,
    [origin, direction]: [[f32; 4]; 2],
) -> f64 {
    let Some(start) = start.filter(|_| direction[3] == 1.0) else {
        let agree = start.is_none() && direction == [0.0; 4];
        assert!(
            agree || at_the_fold(camera, pixel),
            "{pixel:?}: {start:?} {direction:?}"
        );
        return 0.0;
    };
    assert_eq!(origin[..3], start.origin, "{pixel:?}");
    let squares = start.direction.iter().zip(direction);
    let error: f64 = squares.map(|(a, b)| (f64::from(*a) - f64::from(b)).powi(2)).sum();
    error.sqrt() / (DIRECTION * spread(camera, pixel))
}

/// Draws `rays` rays of the training's next step into `rays + 10` slots that held 7s.
fn drawn(gpu: &Gpu, training: &Training, rays: usize) -> RayArrays {
    let photos = Photos::new(gpu, &training.views, &training.world_from_cams, &training.frame).unwrap();
    let observations = observed(&training.observations, &training.march);
    let weight = training.pull_at(training.state.steps, training.ray_count());
    let step = marf_shaders::Step {
        rays: rays as u32,
        observations: weight.map_or(0, |_| observations.len() as u32),
        pull: weight.unwrap_or(0.0),
        ..photos.step(training.seed, training.state.steps)
    };
    let observations = gpu.filled("observations", &observations).unwrap();
    let step = gpu.uniform("step", step).unwrap();
    let arrays = RayArrays::new(gpu, rays + 10).unwrap();
    gpu.write(&arrays.origins, 0, &vec![[7.0; 4]; rays + 10]);
    gpu.write(&arrays.directions, 0, &vec![[7.0; 4]; rays + 10]);
    gpu.write(&arrays.targets, 0, &vec![UNTOUCHED; rays + 10]);
    gpu.write(&arrays.pulls, 0, &vec![[7.0; 2]; rays + 10]);
    let bound = DrawRays::new(gpu)
        .unwrap()
        .bind(gpu, &step, &photos, &observations, &arrays);
    gpu.submit(|recorder| recorder.threads(&bound, rays));
    arrays
}

/// The centre of the pixel that a ray was drawn for.
fn drawn_pixel(training: &Training, ray: u64, target: &Target) -> [f64; 2] {
    let mut rng = random_numbers(training.seed, Purpose::Rays, training.state.steps, ray);
    let (pixel, _) = training.aim(ray, &mut rng);
    let view = target.view as usize;
    training.views[view]
        .image
        .at((pixel - training.pixels[view]) as usize)
        .0
}

#[test]
fn rays_are_drawn_for_the_pixels_that_the_cpu_draws() {
    let Some(gpu) = gpu("rays_are_drawn_for_the_pixels_that_the_cpu_draws") else {
        return;
    };
    let mut training = training();
    let (rays, exposures) = (2000, training.exposures());
    // The second step is beyond the last that pulls.
    for step in [100, (1 << 33) + 5] {
        training.state.steps = step;
        let arrays = drawn(&gpu, &training, rays);
        let (origins, directions) = (
            gpu.read(&arrays.origins).unwrap(),
            gpu.read(&arrays.directions).unwrap(),
        );
        let (targets, pulls) = (
            gpu.read(&arrays.targets).unwrap(),
            gpu.read(&arrays.pulls).unwrap(),
        );
        let (mut worst, mut pulled, mut absent) = (0.0_f64, 0, 0);
        let mut hidden = 0;
        for ray in 0..rays {
            let target = training.target(ray as u64, &exposures);
            assert_eq!(targets[ray], aim(&target), "ray {ray}");
            assert_eq!(origins[ray][3], target.jitter, "ray {ray}");
            let pull = target.pull.map_or([0.0; 2], |pull| [pull.place, pull.weight]);
            assert_eq!(pulls[ray], pull, "ray {ray}");
            pulled += usize::from(target.pull.is_some());
            absent += usize::from(target.start.is_none());
            let pixel = drawn_pixel(&training, ray as u64, &target);
            let lens = training.views[target.view as usize].camera;
            if pixel[0] < f64::from(lens.width / 2) {
                hidden += 1;
                assert_eq!((target.start, directions[ray]), (None, [0.0; 4]), "{pixel:?}");
                continue;
            }
            worst = worst.max(apart(&lens, pixel, target.start, [origins[ray], directions[ray]]));
        }
        eprintln!(
            "step {step}: directions within {worst} of {DIRECTION}; {pulled} pulled, {absent} without inverse"
        );
        assert!(worst < 1.0 && absent > 50, "{worst} {absent}");
        assert!(
            (1..50).contains(&hidden),
            "{hidden} of 2000 in the mask; 1/256 expected"
        );
        assert_eq!(pulled > 100, step == 100, "{pulled}");
        assert_eq!(origins[rays..], vec![[7.0; 4]; 10]);
        assert_eq!(directions[rays..], vec![[7.0; 4]; 10]);
        assert_eq!(targets[rays..], vec![UNTOUCHED; 10]);
        assert_eq!(pulls[rays..], vec![[7.0; 2]; 10]);
    }
}

#[test]
fn every_ray_of_a_picture_runs_through_the_middle_of_its_pixel() {
    let Some(gpu) = gpu("every_ray_of_a_picture_runs_through_the_middle_of_its_pixel") else {
        return;
    };
    let kernel = ViewRays::new(&gpu).unwrap();
    for lens in lenses() {
        let seen = view(lens, 1.0, 1, true);
        let (world_from_cam, frame) = (seen.cam_from_world.inverse(), Frame::derive(&[seen], &[]));
        // From the third row on, past the last.
        let (first, count, slots) = (2 * lens.width, lens.width * lens.height, 5000);
        let asked = PixelRange {
            camera: camera(&lens, &world_from_cam, &frame),
            first,
            count,
            jitter: 0.5,
            pad: 0,
        };
        let asked = gpu.uniform("asked", asked).unwrap();
        let (rays, progress) = (
            RayArrays::new(&gpu, slots).unwrap(),
            Progress::new(&gpu, slots).unwrap(),
        );
        for array in [&progress.next_step, &progress.done] {
            gpu.write(array, 0, &vec![7; slots]);
        }
        let bound = kernel.bind(&gpu, &asked, &rays, &progress);
        gpu.submit(|recorder| recorder.threads(&bound, count as usize));
        let (origins, directions) = (
            gpu.read(&rays.origins).unwrap(),
            gpu.read(&rays.directions).unwrap(),
        );
        let mut worst = 0.0_f64;
        for ray in 0..count {
            let (column, row) = ((first + ray) % lens.width, (first + ray) / lens.width);
            let (origin, direction) = (origins[ray as usize], directions[ray as usize]);
            assert_eq!(origin[3], 0.5);
            if row >= lens.height {
                assert_eq!(direction, [0.0; 4], "{column} {row}");
                continue;
            }
            let pixel = [f64::from(column) + 0.5, f64::from(row) + 0.5];
            let start = frame.ray(&lens, &world_from_cam, pixel);
            worst = worst.max(apart(&lens, pixel, start, [origin, direction]));
        }
        eprintln!("k1 {}: directions within {worst} of {DIRECTION}", lens.k1);
        assert!(worst < 1.0, "{worst}");
        for array in [&progress.next_step, &progress.done] {
            let found = gpu.read(array).unwrap();
            let expected = (0..slots).map(|slot| if slot < count as usize { 0 } else { 7 });
            assert!(found.into_iter().eq(expected));
        }
        assert_eq!(
            directions[count as usize..],
            vec![[0.0; 4]; slots - count as usize]
        );
    }
}

#[test]
fn more_pixels_than_a_binding_holds_are_refused_with_the_key_to_set() {
    let Some(mut gpu) = own_gpu("more_pixels_than_a_binding_holds_are_refused_with_the_key_to_set") else {
        return;
    };
    gpu.limits.max_storage_buffer_binding_size = 1 << 12;
    let training = training();
    let refused = Photos::new(&gpu, &training.views, &training.world_from_cams, &training.frame).err();
    let kept = training.pixels[3];
    assert!(
        matches!(&refused, Some(GpuError::Limit { needed, hint, .. })
            if *needed == 4 * kept && hint.contains("`memory`")),
        "{refused:?}"
    );
}
