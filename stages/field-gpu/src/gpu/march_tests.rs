//! Samples on rays against those of the CPU, and where they begin.

use marf_shaders::{MARCH, Shader, Walk, counts};

use super::Gpu;
use super::array::Array;
use super::march::{
    Alive, March, MarchArrays, MarchPasses, RAY_LANES, SampleArrays, WALKED, bit_words, round, step_table,
    whole_walk,
};
use super::rays::{Progress, RayArrays};
use super::testing::gpu;
use marf_field::cpu::march::{self, Samples, Steps};
use marf_field::cpu::simd::{InstructionSet, Run};
use marf_field::cpu::space::Bits;
use marf_field::rng::{Purpose, random_numbers};
use marf_numeric::Rng;

/// For a position in the unit box, a share of steps, and t and delta by their size: two units in the last
/// place for the division that WGSL leaves to the driver, two for the products.
pub const CLOSE: f32 = 1e-6;

/// Origin and place within every step. Direction and whether there is a ray.
type Ray = [[f32; 4]; 2];

/// All that a walk takes and gives, on the device.
struct Scene {
    walk: Walk,
    told: Array<Walk>,
    bits: Array<u32>,
    spans: Array<u32>,
    counts: Array<u32>,
    samples: SampleArrays,
    progress: Progress,
    marching: MarchPasses,
}

impl Scene {
    /// All samples, spans and counts hold 7s at first.
    fn new(gpu: &Gpu, rays: &[Ray], capacity: usize, steps: &Steps, bits: &Bits) -> Self {
        Self::with_march(gpu, &March::new(gpu).unwrap(), rays, capacity, (steps, bits))
    }

    fn with_march(gpu: &Gpu, march: &March, rays: &[Ray], capacity: usize, space: (&Steps, &Bits)) -> Self {
        let (steps, bits) = space;
        let slots = (rays.len() + 3).next_multiple_of(64);
        let walk = whole_walk(rays.len(), slots, capacity, steps, bits.side);
        let arrays = RayArrays::new(gpu, slots).unwrap();
        let column = |index: usize| rays.iter().map(|ray| ray[index]).collect::<Vec<_>>();
        gpu.write(&arrays.origins, 0, &column(0));
        gpu.write(&arrays.directions, 0, &column(1));
        let told = gpu.uniform("walk", walk).unwrap();
        let table = gpu.filled("steps", &step_table(steps)).unwrap();
        let words = gpu.filled("bits", &bit_words(bits)).unwrap();
        let amounts = gpu.filled("amounts", &vec![7; slots]).unwrap();
        let spans = gpu.filled("spans", &vec![7; WALKED * slots]).unwrap();
        let counts = gpu.filled("counts", &[7; counts::LEN]).unwrap();
        let (progress, samples) = (
            Progress::new(gpu, slots).unwrap(),
            SampleArrays::new(gpu, capacity).unwrap(),
        );
        gpu.write(&samples.xyz, 0, &vec![7.0; 3 * capacity]);
        gpu.write(&samples.along, 0, &vec![7.0; 3 * capacity]);
        gpu.write(&samples.ray_of, 0, &vec![7; capacity]);
        let marching = march.bind(
            gpu,
            MarchArrays {
                walk: &told,
                rays: &arrays,
                steps: &table,
                bits: &words,
                progress: &progress,
                amounts: &amounts,
                walked: &spans,
                counts: &counts,
                samples: &samples,
            },
        );
        Self {
            walk,
            told,
            bits: words,
            spans,
            counts,
            samples,
            progress,
            marching,
        }
    }

    fn run(&self, gpu: &Gpu) -> Found {
        gpu.submit(|recorder| self.marching.record(recorder, self.walk.rays as usize));
        self.found(gpu)
    }

    fn found(&self, gpu: &Gpu) -> Found {
        let spans = gpu.read(&self.spans).unwrap();
        let (first, rest) = spans.split_at(self.walk.ray_slots as usize);
        let count = &rest[..first.len()];
        Found {
            spans: first.iter().copied().zip(count.iter().copied()).collect(),
            counts: gpu.read(&self.counts).unwrap(),
            xyz: gpu.read(&self.samples.xyz).unwrap(),
            along: gpu.read(&self.samples.along).unwrap(),
            ray_of: gpu.read(&self.samples.ray_of).unwrap(),
        }
    }
}

/// What a walk gave.
struct Found {
    spans: Vec<(u32, u32)>,
    counts: Vec<u32>,
    xyz: Vec<f32>,
    along: Vec<f32>,
    ray_of: Vec<u32>,
}

impl Found {
    /// x, y, z, t, delta, place of a sample.
    fn sample(&self, index: usize) -> [f32; 6] {
        let capacity = self.ray_of.len();
        let at = |array: &[f32], column: usize| array[column * capacity + index];
        let (xyz, along) = (&self.xyz, &self.along);
        [
            at(xyz, 0),
            at(xyz, 1),
            at(xyz, 2),
            at(along, 0),
            at(along, 1),
            at(along, 2),
        ]
    }

    fn samples_of(&self, ray: usize) -> Vec<[f32; 6]> {
        let (first, count) = self.spans[ray];
        let indices = first as usize..(first + count) as usize;
        assert!(self.ray_of[indices.clone()].iter().all(|of| *of == ray as u32));
        indices.map(|index| self.sample(index)).collect()
    }
}

fn on_the_cpu(steps: &Steps, bits: &Bits, [origin, direction]: Ray) -> Vec<[f32; 6]> {
    let mut samples = Samples::default();
    if direction[3] == 1.0 {
        InstructionSet::best().run(march::March {
            clearance: None,
            steps,
            bits,
            origin: [origin[0], origin[1], origin[2]],
            direction: [direction[0], direction[1], direction[2]],
            jitter: origin[3],
            first: 0,
            limit: usize::MAX,
            samples: &mut samples,
        });
    }
    let Samples {
        x,
        y,
        z,
        t,
        delta,
        place,
    } = samples;
    (0..x.len())
        .map(|k| [x[k], y[k], z[k], t[k], delta[k], place[k]])
        .collect()
}

/// Compares samples one by one and returns the largest error, by size where numbers exceed 1.
fn apart(found: &[[f32; 6]], expected: &[[f32; 6]], what: &str) -> f32 {
    assert_eq!(found.len(), expected.len(), "{what}");
    let pairs = found.as_flattened().iter().zip(expected.as_flattened());
    pairs.fold(0.0, |worst, (found, expected)| {
        let error = (found - expected).abs() / expected.abs().max(1.0);
        assert!(error <= CLOSE, "{what}: {found} {expected}");
        error.max(worst)
    })
}

fn unit(rng: &mut Rng) -> [f32; 3] {
    loop {
        let v = [0; 3].map(|_| rng.unit_f32() * 2.0 - 1.0);
        let norm = v.iter().map(|x| x * x).sum::<f32>().sqrt();
        if (0.1..1.0).contains(&norm) {
            return v.map(|x| x / norm);
        }
    }
}

/// Cells a side of grids with random cells.
const SIDE: u32 = 16;

/// Rays from within 1.5 half sides. Every ninth is missing. No step of theirs is so close to a border of a
/// cell that a driver's rounding might put it on the other side.
fn random_rays(count: usize, steps: &Steps, rng: &mut Rng) -> Vec<Ray> {
    let mut drawn = |index: usize| {
        let ([x, y, z], from) = (unit(rng), [0; 3].map(|_| rng.unit_f32() * 3.0 - 1.5));
        let there = f32::from(index % 9 != 4);
        [[from[0], from[1], from[2], rng.unit_f32()], [x, y, z, there]]
    };
    let is_clear = |ray: &Ray| {
        let places = on_the_cpu(steps, &full(SIDE), *ray);
        let mut cells = places.iter().flat_map(|at| &at[..3]).map(|x| x * SIDE as f32);
        cells.all(|x| (x - x.round()).abs() > 4.0 * CLOSE * SIDE as f32)
    };
    let clear = |index| loop {
        let ray = drawn(index);
        if is_clear(&ray) {
            break ray;
        }
    };
    (0..count).map(clear).collect()
}

/// One cell in four, and every bit of some words.
fn random_bits(side: u32, rng: &mut Rng) -> Bits {
    let mut bits = Bits::new(side);
    bits.words.iter_mut().for_each(|word| {
        *word = match rng.below(8) {
            0 => u64::MAX,
            _ => rng.bits() & rng.bits(),
        }
    });
    bits
}

fn full(side: u32) -> Bits {
    let mut bits = Bits::new(side);
    bits.words.fill(u64::MAX);
    bits
}

#[test]
fn a_walk_finds_the_samples_of_the_cpu_and_leaves_the_rest_alone() {
    let Some(gpu) = gpu("a_walk_finds_the_samples_of_the_cpu_and_leaves_the_rest_alone") else {
        return;
    };
    let mut rng = random_numbers(1, Purpose::Rays, 0, 0);
    let steps = Steps::new(0.05, 512.0, 0.03, 0.06);
    let (rays, bits) = (random_rays(150, &steps, &mut rng), random_bits(SIDE, &mut rng));
    assert_ne!(steps.count % 16, 0);
    let expected: Vec<_> = rays.iter().map(|ray| on_the_cpu(&steps, &bits, *ray)).collect();
    let total: usize = expected.iter().map(Vec::len).sum();
    let scene = Scene::new(&gpu, &rays, 16384, &steps, &bits);
    let found = scene.run(&gpu);
    let mut worst = 0.0_f32;
    for (ray, expected) in expected.iter().enumerate() {
        worst = worst.max(apart(&found.samples_of(ray), expected, &format!("ray {ray}")));
    }
    eprintln!("{total} samples, largest error {worst:e}");
    assert_eq!(found.counts, [total as u32, 7, 150, 0]);
    // The next block is filled up with samples of no length. Nothing is written behind it.
    let padded = total.next_multiple_of(16);
    assert!(total > 1000 && padded > total, "{total}");
    assert!((total..padded).all(|index| found.sample(index) == [0.0; 6] && found.ray_of[index] == 0));
    assert!((padded..16384).all(|index| found.sample(index) == [7.0; 6] && found.ray_of[index] == 7));
    assert!(found.spans[150..].iter().all(|span| *span == (7, 7)));
    assert!(
        gpu.read(&scene.progress.next_step)
            .unwrap()
            .iter()
            .all(|step| *step == 0)
    );
}

/// Which samples there are is compared strictly: rays are drawn clear of the borders of cells. Here a driver
/// is simulated that is off by nearly all of [`CLOSE`], with which rays that are not clear have other samples.
#[test]
fn a_driver_that_is_off_by_some_units_in_the_last_place_finds_the_same_samples() {
    let name = "a_driver_that_is_off_by_some_units_in_the_last_place_finds_the_same_samples";
    let Some(gpu) = gpu(name) else {
        return;
    };
    let mut rng = random_numbers(2, Purpose::Rays, 0, 0);
    let steps = Steps::new(0.05, 512.0, 0.03, 0.06);
    let (rays, bits) = (random_rays(4000, &steps, &mut rng), random_bits(SIDE, &mut rng));
    let expected: Vec<_> = rays.iter().map(|ray| on_the_cpu(&steps, &bits, *ray)).collect();
    let place = "fma(p * scale, vec3(0.25), vec3(0.5))";
    for off in ["+ vec3(12u)", "- vec3(12u)"] {
        let nudged = format!("bitcast<vec3<f32>>(bitcast<vec3<u32>>({place}) {off})");
        let text = MARCH.text.replace(place, &nudged);
        assert_ne!(text, MARCH.text);
        let shader = Shader {
            text: text.leak(),
            ..MARCH
        };
        let march = March::from_shader(&gpu, &shader).unwrap();
        let found = Scene::with_march(&gpu, &march, &rays, 1 << 19, (&steps, &bits)).run(&gpu);
        let pairs = expected.iter().enumerate();
        let errors = pairs.map(|(ray, expected)| apart(&found.samples_of(ray), expected, off));
        let worst = errors.fold(0.0, f32::max);
        assert!(worst > 0.5 * CLOSE, "{off}: {worst:e} plays no driver");
    }
}

#[test]
fn rays_along_faces_on_faces_and_far_away_end_as_on_the_cpu() {
    let Some(gpu) = gpu("rays_along_faces_on_faces_and_far_away_end_as_on_the_cpu") else {
        return;
    };
    let origins = [
        [1.0, 0.0, 0.0],
        [0.0; 3],
        [-0.0; 3],
        [-1.0, 1.0, 1.0],
        [1e5, 0.0, 3.0],
        [-2e5, 7.0, 1e5],
        [f32::NAN, 0.0, 0.0],
    ];
    let directions = [
        [1.0, 0.0, 0.0],
        [0.0, -1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.6, 0.0, -0.8],
    ];
    let ray = |o: [f32; 3], d: [f32; 3]| [[o[0], o[1], o[2], 0.5], [d[0], d[1], d[2], 1.0]];
    let pairs = origins.iter().flat_map(|o| directions.map(|d| ray(*o, d)));
    let rays: Vec<Ray> = pairs.collect();
    for (what, steps, bits) in [
        ("full", Steps::new(0.1, 512.0, 0.05, 0.05), full(16)),
        ("empty", Steps::new(0.1, 512.0, 0.05, 0.05), Bits::new(16)),
        ("no steps", Steps::new(2.0, 2.0, 0.1, 0.1), full(16)),
        ("one step", Steps::new(1.0, 1.1, 0.5, 0.0), full(20)),
    ] {
        let found = Scene::new(&gpu, &rays, 8192, &steps, &bits).run(&gpu);
        for (index, ray) in rays.iter().enumerate() {
            let (expected, found) = (on_the_cpu(&steps, &bits, *ray), found.samples_of(index));
            if what != "empty" {
                assert_eq!(expected.len(), steps.count, "{ray:?}");
            }
            if ray[0][0].is_nan() {
                // Counted in cell 0 by both. Its lookup there runs away and is a fault.
                assert_eq!(found.len(), expected.len(), "{what} {ray:?}");
                continue;
            }
            apart(&found, &expected, &format!("{what} {ray:?}"));
        }
        assert_eq!(found.counts[counts::RAYS as usize], rays.len() as u32, "{what}");
    }
}

#[test]
fn what_is_written_never_leaves_its_span() {
    let Some(gpu) = gpu("what_is_written_never_leaves_its_span") else {
        return;
    };
    let mut rng = random_numbers(5, Purpose::Rays, 0, 0);
    let steps = Steps::new(0.05, 64.0, 0.03, 0.06);
    let rays = random_rays(70, &steps, &mut rng);
    // Between counting and writing every cell fills, or empties.
    for (counted, written) in [(random_bits(16, &mut rng), full(16)), (full(16), Bits::new(16))] {
        let scene = Scene::new(&gpu, &rays, 16384, &steps, &counted);
        gpu.submit(|recorder| scene.marching.record_count(recorder, rays.len()));
        gpu.write(&scene.bits, 0, &bit_words(&written));
        gpu.submit(|recorder| scene.marching.record_write(recorder, rays.len()));
        let found = scene.found(&gpu);
        // A lane has a run of steps of a ray, and as many samples of its span as it counted.
        let run = (steps.begin.len() / 16).div_ceil(RAY_LANES) * 16;
        let of_run = |samples: &[[f32; 6]], lane: usize| -> Vec<[f32; 6]> {
            let is_in = |sample: &&[f32; 6]| (sample[5] * steps.count as f32) as usize / run == lane;
            samples.iter().filter(is_in).copied().collect()
        };
        for (ray, begin) in rays.iter().enumerate() {
            let [counted, written] = [&counted, &written].map(|bits| on_the_cpu(&steps, bits, *begin));
            let shares = (0..RAY_LANES).map(|lane| {
                let mut share = of_run(&written, lane);
                share.resize(of_run(&counted, lane).len(), [0.0; 6]);
                share
            });
            let expected = shares.collect::<Vec<_>>().concat();
            apart(&found.samples_of(ray), &expected, &format!("ray {ray}"));
        }
    }
}

#[test]
fn rays_from_the_first_that_does_not_fit_on_are_clipped() {
    let Some(gpu) = gpu("rays_from_the_first_that_does_not_fit_on_are_clipped") else {
        return;
    };
    let mut rng = random_numbers(2, Purpose::Rays, 0, 0);
    let steps = Steps::new(0.05, 512.0, 0.03, 0.06);
    let (rays, bits) = (random_rays(100, &steps, &mut rng), random_bits(SIDE, &mut rng));
    let expected: Vec<_> = rays.iter().map(|ray| on_the_cpu(&steps, &bits, *ray)).collect();
    let found = Scene::new(&gpu, &rays, 1024, &steps, &bits).run(&gpu);
    let fits = found.counts[counts::RAYS as usize] as usize;
    let total: usize = expected[..fits].iter().map(Vec::len).sum();
    assert!(fits > 5 && total <= 1024 && total + expected[fits].len() > 1024);
    assert_eq!(found.counts[counts::VISITED as usize], total as u32);
    for (ray, expected) in expected[..fits].iter().enumerate() {
        apart(&found.samples_of(ray), expected, &format!("ray {ray}"));
    }
    assert_eq!(found.spans[fits..100], vec![(u32::MAX, 0); 100 - fits]);
}

#[test]
fn a_picture_in_rounds_finds_every_sample_although_few_fit_at_once() {
    let Some(gpu) = gpu("a_picture_in_rounds_finds_every_sample_although_few_fit_at_once") else {
        return;
    };
    let mut rng = random_numbers(3, Purpose::Rays, 0, 0);
    let steps = Steps::new(0.05, 64.0, 0.03, 0.06);
    let (rays, bits) = (random_rays(80, &steps, &mut rng), random_bits(SIDE, &mut rng));
    let scene = Scene::new(&gpu, &rays, 512, &steps, &bits);
    let slots = scene.walk.ray_slots as usize;
    // Everything passes, but for ray 1, which ends with its first round.
    let mut state = vec![1.0_f32; 6 * slots];
    state[5 * slots + 1] = 0.0;
    let state = gpu.filled("state", &state).unwrap();
    let alive = Alive::new(&gpu)
        .unwrap()
        .bind(&gpu, &scene.told, &state, &scene.progress, &scene.counts);
    let (mut parts, mut limit, mut clipped) = (vec![Vec::new(); rays.len()], 8, 0);
    for rounds in 0.. {
        assert!(rounds < 100, "a round does not come on");
        gpu.write(&scene.told, 0, &[round(scene.walk, limit)]);
        let found = scene.run(&gpu);
        for (ray, part) in parts.iter_mut().enumerate() {
            match found.spans[ray] {
                (u32::MAX, count) => {
                    assert_eq!(count, 0);
                    clipped += 1;
                }
                _ => part.extend(found.samples_of(ray)),
            }
        }
        gpu.submit(|recorder| recorder.threads(&alive, rays.len()));
        limit *= 2;
        if gpu.read(&scene.counts).unwrap()[counts::ALIVE as usize] == 0 {
            break;
        }
    }
    assert!(clipped > 0);
    for (ray, part) in parts.iter().enumerate().filter(|(ray, _)| *ray != 1) {
        apart(part, &on_the_cpu(&steps, &bits, rays[ray]), &format!("ray {ray}"));
    }
    // A block of 16 steps is finished, then the ray pauses: 8 to 23 samples.
    let (whole, visited) = (on_the_cpu(&steps, &bits, rays[1]), parts[1].len());
    assert!((8..24).contains(&visited) && whole.len() > 24, "{visited}");
    apart(&parts[1], &whole[..visited], "ray 1");
    assert_eq!(
        gpu.read(&scene.progress.done).unwrap()[..rays.len()],
        vec![1; rays.len()]
    );
}
