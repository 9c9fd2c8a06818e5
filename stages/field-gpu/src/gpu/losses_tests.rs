//! The loss of rays and its slopes against their twins on the CPU.

use marf_shaders::{Pace, SpreadRun, Target, Total, counts, faults, found};

use super::array::Part;
use super::light::{Aims, Colours, Light, RING, SlopeArrays};
use super::light_tests::{
    Arrays, CAPACITY, CELL, NO_RAY, RAYS, SIZE, SLOTS, directions, harmonics, spans, visited,
};
use super::rig::{Rig, TOLERANCE, UNTOUCHED, agree, columns, is_untouched};
use super::testing::numbers;
use marf_field::cpu::composite::{Gathered, RAW_LIMIT, Ray, colour, colour_slope};
use marf_field::cpu::math::exp;
use marf_field::cpu::simd::InstructionSet;
use marf_field::depth::{FLOOR, Pull, REACH};
use marf_field::exposure::Exposure;
use marf_field::sh;
use marf_field::shade::{Shade, Span};

const VIEWS: usize = 3;

/// Kept samples with colours, and what rays are compared with.
struct Scene {
    shade: Shade,
    spans: Vec<Span>,
    logits: Vec<[f32; 3]>,
    directions: Vec<[f32; 4]>,
    targets: Vec<Target>,
    gains: Vec<[f32; 4]>,
    background: Option<Vec<f32>>,
    pulls: Vec<[f32; 2]>,
}

impl Scene {
    fn new(has_background: bool) -> Self {
        let (mut shade, before) = visited();
        shade
            .samples
            .delta
            .iter_mut()
            .for_each(|delta| *delta = delta.min(1.0));
        let (mut spans, mut kept) = (spans(), Vec::new());
        shade.opacities(InstructionSet::best(), &spans, &before);
        shade.choose(0, &spans, &mut kept);
        shade.keep(&mut spans, &kept);
        let n = shade.raw.len();
        let logits = numbers(3 * n, 37)
            .chunks(3)
            .map(|x| [12.0 * x[0], 3.0 * x[1], 3.0 * x[2]])
            .collect();
        let targets = numbers(3 * SLOTS, 38);
        let targets = targets.as_chunks::<3>().0.iter().enumerate();
        let targets = targets.map(|(ray, x)| Target {
            rgb: x.map(f32::abs),
            view: (ray % VIEWS) as u32,
            behind: [x[1].abs(), x[2].abs(), x[0].abs()],
            // The background behind two of five, else a pixel that shows all, a part, or nothing of a colour of its own.
            share: [-1.0, 0.0, 0.4, 1.0, -1.0][ray % 5],
        });
        let gains = numbers(8 * VIEWS, 39);
        let gains = gains
            .chunks(4)
            .map(|x| [0.3 * x[0], 0.3 * x[1], 0.3 * x[2], 0.0])
            .collect();
        let pulls = (0..SLOTS).map(|ray| match ray % 4 {
            0 => [0.09, 0.01],
            1 => [0.5, 0.01],
            // Sky.
            2 => [2.0, 0.01],
            _ => [0.1, 0.0],
        });
        Self {
            shade,
            spans,
            logits,
            directions: directions(),
            targets: targets.collect(),
            gains,
            background: has_background.then(|| numbers(48, 40)),
            pulls: pulls.collect(),
        }
    }

    fn exposure(&self, ray: usize) -> Exposure {
        let view = self.targets[ray].view as usize;
        let [gain, offset] = [self.gains[view], self.gains[VIEWS + view]];
        Exposure {
            gain: [exp(gain[0]), exp(gain[1]), exp(gain[2])],
            offset: [offset[0], offset[1], offset[2]],
        }
    }

    fn logits_behind(&self, harmonics: &[f32; sh::COUNT]) -> Option<[f32; 3]> {
        let rows = self.background.as_ref()?.chunks(sh::COUNT);
        let logit = |row: &[f32]| {
            row.iter()
                .zip(harmonics)
                .fold(0.0_f32, |sum, (a, b)| a.mul_add(*b, sum))
        };
        let logits: Vec<f32> = rows.map(logit).collect();
        Some([logits[0], logits[1], logits[2]])
    }
}

/// Distortion and emptiness.
const LOSSES: [f32; 2] = [1e-2, 3e-3];

/// What the CPU finds: rows of `found`, parts of the background's gradient, slopes in raw densities and logits.
struct Expected {
    found: Vec<f32>,
    parts: Vec<f32>,
    d_raw: Vec<f32>,
    d_logits: Vec<f32>,
}

/// As `batch::Losses::ray`, for all rays.
fn expected(scene: &Scene) -> Expected {
    let mut all = Expected {
        found: vec![UNTOUCHED; found::LEN * SLOTS],
        parts: vec![0.0; SLOTS],
        d_raw: vec![UNTOUCHED; CAPACITY],
        d_logits: vec![UNTOUCHED; 3 * CAPACITY],
    };
    for ray in 0..RAYS {
        let mut put = |row: usize, value: f32| all.found[row * SLOTS + ray] = value;
        if ray == NO_RAY {
            (0..found::LEN).for_each(|row| put(row, 0.0));
            continue;
        }
        let Span { first, end } = scene.spans[ray];
        let shade = &scene.shade;
        let logits = &scene.logits[first..end];
        let rgb: Vec<[f32; 4]> = logits
            .iter()
            .map(|logits| [colour(logits[0]), colour(logits[1]), colour(logits[2]), 0.0])
            .collect();
        let samples = Ray {
            alpha: &shade.alpha[first..end],
            transmittance: &shade.transmittance[first..end],
            rgb: &rgb,
            place: &shade.samples.place[first..end],
        };
        let Gathered { rgb: sum, left } = samples.gather();
        let harmonics = harmonics(&scene.directions[ray]);
        let target = scene.targets[ray];
        let has_own = target.share >= 0.0;
        let logits_behind = scene.logits_behind(&harmonics).filter(|_| !has_own);
        let background = logits_behind.map_or([0.0; 3], |logits| logits.map(colour));
        let behind = if has_own { target.behind } else { background };
        let passes = left - target.share.max(0.0);
        let plain = [0, 1, 2].map(|channel| passes.mul_add(behind[channel], sum[channel]));
        let compared = scene
            .exposure(ray)
            .compare(plain, target.rgb, 2.0 / (3 * RAYS) as f32);
        let slope = compared.colour;
        put(found::LOSS, compared.squares.iter().sum());
        put(found::TOWARDS, slope.iter().zip(behind).map(|(a, b)| a * b).sum());
        for channel in 0..3 {
            put(found::GAIN + channel, compared.exposure.gain[channel]);
            put(found::OFFSET + channel, compared.exposure.offset[channel]);
            put(found::SLOPE + channel, slope[channel]);
            let inner = logits_behind.map_or(0.0, |logits| colour_slope(logits[channel], behind[channel]));
            let part = &mut all.parts[ray / 64 * 64 + sh::COUNT * channel..];
            for (sum, harmonic) in part.iter_mut().zip(harmonics) {
                *sum += left * slope[channel] * inner * harmonic;
            }
        }
        let n = end - first;
        let (mut d_tau, mut d_rgb) = (vec![0.0; n], vec![[0.0; 4]; n]);
        let [distortion, emptiness] = LOSSES.map(|weight| weight / RAYS as f32);
        samples.spread(slope, behind, [distortion, CELL], &mut d_tau, &mut d_rgb);
        for (slope, alpha) in d_tau.iter_mut().zip(samples.alpha) {
            *slope = emptiness.mul_add(1.0 - alpha, *slope);
        }
        let [place, weight] = scene.pulls[ray];
        if weight > 0.0 {
            Pull { place, weight }.spread(&samples, CELL, &mut d_tau);
        }
        for at in 0..n {
            let raw = shade.raw[first + at];
            let is_cut = raw >= RAW_LIMIT;
            all.d_raw[first + at] = if is_cut {
                0.0
            } else {
                d_tau[at] * shade.tau[first + at]
            };
            for channel in 0..3 {
                let slope = colour_slope(logits[at][channel], rgb[at][channel]);
                all.d_logits[channel * CAPACITY + first + at] = d_rgb[at][channel] * slope;
            }
        }
    }
    all
}

/// Writes light as `opacity` leaves it.
fn write_light(rig: &Rig, arrays: &Arrays, shade: &Shade) {
    let pairs = shade.tau.iter().zip(&shade.raw);
    let tau = pairs.map(|(tau, raw)| if *raw < RAW_LIMIT { *tau } else { 0.0 });
    for (row, values) in [&tau.collect(), &shade.alpha, &shade.transmittance]
        .into_iter()
        .enumerate()
    {
        rig.gpu.write(&arrays.light, row * CAPACITY, values);
    }
}

/// What the device finds, and the arrays it read.
fn composited(rig: &Rig, scene: &Scene) -> (Expected, Total) {
    let kernels = Light::new(&rig.gpu).unwrap();
    let shade = &scene.shade;
    let arrays = Arrays::new(rig, shade, &scene.spans);
    write_light(rig, &arrays, shade);
    let flat: Vec<f32> = scene.logits.concat();
    let rgb: Vec<f32> = flat.iter().map(|logit| colour(*logit)).collect();
    let [logits, rgb] = [flat, rgb].map(|rows| rig.filled(&columns(&rows, 3, CAPACITY, f32::NAN)));
    let vectors = |values: &[[f32; 4]]| rig.gpu.filled("vectors", values).unwrap();
    let [directions, gains] = [&scene.directions, &scene.gains].map(|x| vectors(x));
    let targets = rig.gpu.filled("targets", &scene.targets).unwrap();
    let background = scene.background.as_ref().map(|values| rig.filled(values));
    let pulls = rig.gpu.filled("pulls", &scene.pulls).unwrap();
    let found = rig.filled(&[UNTOUCHED; found::LEN * SLOTS]);
    let parts = rig.filled(&[UNTOUCHED; SLOTS]);
    let d_outputs = rig.untouched(16);
    let aims = Aims {
        directions: &directions,
        targets: &targets,
        gains: &gains,
        views: VIEWS,
        background: background.as_ref().map(Part::from),
        found: &found,
        parts: (&parts).into(),
    };
    let run = SpreadRun {
        slot: counts::RAYS,
        capacity: CAPACITY as u32,
        rays: SLOTS as u32,
        distortion: LOSSES[0],
        cell: CELL,
        emptiness: LOSSES[1],
        reach: REACH,
        floor: FLOOR,
    };
    let run = rig.gpu.uniform("spread", run).unwrap();
    let pace = Pace {
        total: 18,
        ..Pace::default()
    };
    let pace = rig.gpu.uniform("pace", pace).unwrap();
    let ring = rig.gpu.zeros::<Total>("ring", RING).unwrap();
    let colours = Colours {
        logits: (&logits).into(),
        rgb: (&rgb).into(),
    };
    let columns = arrays.columns();
    let slopes = SlopeArrays {
        found: &found,
        pulls: &pulls,
        d_outputs: &d_outputs,
    };
    let loss = found.part(found::LOSS * SLOTS, SLOTS);
    let runs = [
        kernels
            .compare(rig.batch(), columns, (&rgb).into(), aims)
            .unwrap(),
        kernels
            .spread(rig.batch(), &run, columns, colours, slopes)
            .unwrap(),
        kernels.totals(rig.batch(), &pace, loss, &ring).unwrap(),
    ];
    rig.gpu
        .submit(|recorder| runs.iter().for_each(|run| run.record(recorder)));
    let d_outputs = rig.gpu.read(&d_outputs).unwrap();
    assert!(d_outputs[4 * CAPACITY..].iter().all(is_untouched));
    let ring = rig.gpu.read(&ring).unwrap();
    assert!(
        ring.iter()
            .enumerate()
            .all(|(at, total)| at == 2 || *total == Total::default())
    );
    let all = Expected {
        found: rig.gpu.read(&found).unwrap(),
        parts: rig.gpu.read(&parts).unwrap(),
        d_raw: d_outputs[3 * CAPACITY..4 * CAPACITY].to_vec(),
        d_logits: d_outputs[..3 * CAPACITY].to_vec(),
    };
    (all, ring[2])
}

#[test]
fn the_loss_of_rays_and_its_slopes_are_those_of_the_cpu() {
    let test = "the_loss_of_rays_and_its_slopes_are_those_of_the_cpu";
    for has_background in [true, false] {
        let scene = Scene::new(has_background);
        let kept = scene.spans[RAYS - 1].end;
        let Some(rig) = Rig::new(test, SIZE, [234, kept as u32, RAYS as u32]) else {
            return;
        };
        let (found, total) = composited(&rig, &scene);
        let expected = expected(&scene);
        for (row, (found, expected)) in found
            .found
            .chunks(SLOTS)
            .zip(expected.found.chunks(SLOTS))
            .enumerate()
        {
            agree(
                &format!("compare, row {row}"),
                &found[..RAYS],
                &expected[..RAYS],
                TOLERANCE,
            );
            assert!(found[RAYS..].iter().all(is_untouched), "{row}");
        }
        let (used, rest) = found.parts.split_at(RAYS.next_multiple_of(64));
        if has_background {
            agree("background", used, &expected.parts[..used.len()], TOLERANCE);
        } else {
            assert!(used.iter().all(is_untouched));
        }
        assert!(!rest.is_empty() && rest.iter().all(is_untouched));
        agree(
            "slope in raw densities",
            &found.d_raw[..kept],
            &expected.d_raw[..kept],
            TOLERANCE,
        );
        let cut = (0..kept).filter(|sample| scene.shade.raw[*sample] >= RAW_LIMIT);
        let slopes: Vec<f32> = cut.map(|sample| found.d_raw[sample]).collect();
        assert!(
            !slopes.is_empty() && slopes.iter().all(|slope| *slope == 0.0),
            "{slopes:?}"
        );
        let rows = found
            .d_logits
            .chunks(CAPACITY)
            .zip(expected.d_logits.chunks(CAPACITY));
        for (found, expected) in rows {
            agree("slope in logits", &found[..kept], &expected[..kept], TOLERANCE);
            // A card may flush denormals to 0.
            let zeros = |slopes: &[f32]| slopes.iter().map(|slope| slope.abs() < 1e-30).collect::<Vec<_>>();
            assert_eq!(zeros(&found[..kept]), zeros(&expected[..kept]));
            assert!(found[kept..].iter().all(is_untouched));
        }
        let loss: f32 = expected.found[found::LOSS * SLOTS..][..RAYS].iter().sum();
        assert!(
            (total.loss - loss).abs() < 1e-5 * loss,
            "{} against {loss}",
            total.loss
        );
        assert_eq!(
            (total.visited, total.kept, total.rays),
            (234, kept as u32, RAYS as u32)
        );
        assert_eq!((total.faults, rig.faulty()), (0, vec![]));
    }
}

#[test]
fn losses_backgrounds_and_exposures_that_run_away_are_told() {
    let test = "losses_backgrounds_and_exposures_that_run_away_are_told";
    type Spoil = fn(&mut Scene);
    let bad: [(Spoil, Vec<u32>); 4] = [
        (|scene| scene.targets[3].rgb[1] = 1e9, vec![faults::LOSS]),
        (
            |scene| scene.targets[3].rgb[1] = f32::NAN,
            vec![faults::LOSS, faults::EXPOSURES],
        ),
        (|scene| scene.gains[VIEWS + 1][2] = 1e4, vec![]),
        (
            |scene| scene.background.as_mut().unwrap()[47] = f32::NAN,
            vec![faults::BACKGROUND],
        ),
    ];
    for (index, (spoil, faults)) in bad.into_iter().enumerate() {
        let mut scene = Scene::new(true);
        spoil(&mut scene);
        let Some(rig) = Rig::new(test, SIZE, [234, 200, RAYS as u32]) else {
            return;
        };
        let (_, total) = composited(&rig, &scene);
        assert_eq!(rig.faulty(), faults, "{index}");
        assert_eq!(
            total.faults,
            faults.iter().map(|fault| 1 << fault).sum::<u32>(),
            "{index}"
        );
    }
}
