//! Light along rays against its twins on the CPU.

use super::array::Array;
use super::batch::BatchSize;
use super::light::{Columns, Light};
use super::rig::{Rig, TOLERANCE, UNTOUCHED, agree, columns, is_untouched};
use super::testing::numbers;
use marf_field::cpu::composite::{OPAQUE, RAW_LIMIT, runs_away};
use marf_field::cpu::simd::InstructionSet;
use marf_field::sh;
use marf_field::shade::{Shade, Span};
use marf_shaders::faults;

pub const CAPACITY: usize = 512;
pub const SLOTS: usize = 192;
/// Slots of both.
pub const SIZE: BatchSize = BatchSize {
    samples: CAPACITY,
    rays: SLOTS,
};
pub const RAYS: usize = 70;
/// The ray that the distortion has no inverse for.
pub const NO_RAY: usize = 5;
pub const CELL: f32 = 0.02;

pub fn directions() -> Vec<[f32; 4]> {
    let numbers = numbers(3 * SLOTS, 31);
    let rays = numbers.chunks(3).enumerate().map(|(ray, at)| {
        let length = at.iter().map(|x| x * x).sum::<f32>().sqrt();
        match ray {
            NO_RAY => [f32::NAN, 0.0, 0.0, 0.0],
            _ => [at[0] / length, at[1] / length, at[2] / length, 1.0],
        }
    });
    rays.collect()
}

pub fn harmonics(direction: &[f32; 4]) -> [f32; sh::COUNT] {
    match direction {
        [x, y, z, 1.0] => sh::harmonics([*x, *y, *z]),
        _ => [0.0; sh::COUNT],
    }
}

/// Spans of rays of 0 to 12 samples.
pub fn spans() -> Vec<Span> {
    let mut end = 0;
    let rays = (0..RAYS).map(|ray| {
        let first = end;
        end += if ray == NO_RAY { 0 } else { ray % 13 };
        Span { first, end }
    });
    rays.collect()
}

fn spans_array(spans: &[Span]) -> Vec<u32> {
    rows_of_spans([spans, spans])
}

/// Spans of visited samples and of kept ones.
fn rows_of_spans(spans: [&[Span]; 2]) -> Vec<u32> {
    let mut array = vec![0; 4 * SLOTS];
    for (rows, spans) in array.chunks_mut(2 * SLOTS).zip(spans) {
        for (ray, span) in spans.iter().enumerate() {
            rows[ray] = span.first as u32;
            rows[SLOTS + ray] = (span.end - span.first) as u32;
        }
    }
    array
}

/// Visited samples with raw densities and lengths of all sizes.
pub fn visited() -> (Shade, Vec<f32>) {
    let n = spans().last().map_or(0, |span| span.end);
    let mut shade = Shade::default();
    shade.samples.resize(n);
    shade.raw = numbers(n, 32).iter().map(|x| 4.0 * x).collect();
    shade.samples.delta = numbers(n, 33).iter().map(|x| 0.05 * (x + 1.1)).collect();
    shade.samples.t = numbers(n, 34);
    shade.samples.place = (0..n).map(|at| (at % 13) as f32 * CELL).collect();
    let extremes = [
        (100.0, 0.1),
        (-100.0, 0.1),
        (11.0, 0.0),
        (10.9, 1e30),
        (1e9, 0.01),
        (-1e9, 1e9),
    ];
    for (index, (raw, delta)) in extremes.into_iter().enumerate() {
        shade.raw[7 + 31 * index] = raw;
        shade.samples.delta[7 + 31 * index] = delta;
    }
    let mut before = vec![0.0; SLOTS];
    before[20..23].copy_from_slice(&[9.0, 9.3, 1e9]);
    (shade, before)
}

pub struct Arrays {
    pub spans: Array<u32>,
    pub along: Array<f32>,
    pub density: Array<f32>,
    pub light: Array<f32>,
}

impl Arrays {
    pub fn new(rig: &Rig, shade: &Shade, spans: &[Span]) -> Self {
        let samples = &shade.samples;
        let mut along = vec![UNTOUCHED; 3 * CAPACITY];
        for (row, values) in [&samples.t, &samples.delta, &samples.place]
            .into_iter()
            .enumerate()
        {
            along[row * CAPACITY..][..values.len()].copy_from_slice(values);
        }
        Self {
            spans: rig.gpu.filled("spans", &spans_array(spans)).unwrap(),
            along: rig.filled(&along),
            density: rig.filled(&columns(&shade.raw, 1, CAPACITY, f32::NAN)),
            light: rig.untouched(3),
        }
    }

    pub fn columns(&self) -> Columns<'_> {
        Columns {
            spans: &self.spans,
            along: &self.along,
            density: &self.density,
            light: &self.light,
        }
    }
}

#[test]
fn opacities_and_what_shows_are_those_of_the_cpu() {
    lit("opacities_and_what_shows_are_those_of_the_cpu", 0);
}

#[test]
fn samples_chosen_by_weight_are_those_of_the_cpu() {
    lit("samples_chosen_by_weight_are_those_of_the_cpu", 3);
}

/// Compares what `opacity` writes, `most` samples of a ray being kept, and the list that follows from it.
fn lit(test: &str, most: u32) {
    let (mut shade, before) = visited();
    let n = shade.raw.len();
    let Some(rig) = Rig::new(test, SIZE, [n as u32, 0, RAYS as u32]) else {
        return;
    };
    let kernels = Light::new(&rig.gpu).unwrap();
    let mut spans = spans();
    let visited = spans.clone();
    let arrays = Arrays::new(&rig, &shade, &spans);
    let shown = vec![9; SIZE.shown_words()];
    let shown = rig.gpu.filled("shown", &shown).unwrap();
    let front = rig.filled(&before);
    let chosen = SIZE.extent(most);
    let chosen = rig.gpu.uniform("chosen", chosen).unwrap();
    let run = kernels.opacity(rig.batch(), &chosen, arrays.columns(), &front, &shown);
    rig.gpu.submit(|recorder| run.record(recorder));

    let level = InstructionSet::best();
    shade.opacities(level, &spans, &before);
    let words = rig.gpu.read(&shown).unwrap();
    let depths = spans
        .iter()
        .map(|span| shade.tau[span.first..span.end].iter().sum::<f32>());
    let found = words[SLOTS..].iter().map(|bits| f32::from_bits(*bits));
    for (ray, (found, expected)) in found.zip(depths).enumerate() {
        assert!(
            (found - expected).abs() <= TOLERANCE * expected,
            "{ray}: {found} against {expected}"
        );
    }
    // A driver's rounding decides neither what shows nor what is chosen.
    let near = |passes: &f32| (passes / OPAQUE - 1.0).abs() < 1e-4;
    assert!(!shade.transmittance.iter().any(near));
    let kept = chosen_by(&mut shade, &spans, most, 1.0);
    for factor in [1.0 - 2e-6, 1.0 + 2e-6] {
        assert_eq!(chosen_by(&mut shade.clone(), &spans, most, factor), kept);
    }
    shade.keep(&mut spans, &kept);
    if most > 0 {
        shade.opacities(level, &spans, &before);
    }
    let expected: Vec<u32> = spans.iter().map(|span| (span.end - span.first) as u32).collect();
    assert_eq!(&words[..RAYS], expected);
    assert!(kept.len() + 20 < n, "{} of {n} kept proves little", kept.len());
    assert!(words[RAYS..SLOTS].iter().all(|count| *count == 0));
    assert!(rig.faulty().is_empty() != shade.raw.iter().any(|raw| runs_away(*raw)));
    in_front(&rig, &arrays, &shade, &visited, &spans);
    listed(&rig, &kernels, [&visited, &spans], &shown, &kept);
}

/// The samples that the CPU keeps with all opacities multiplied by `factor`.
fn chosen_by(shade: &mut Shade, spans: &[Span], most: u32, factor: f32) -> Vec<u32> {
    let mut kept = Vec::new();
    shade.alpha.iter_mut().for_each(|alpha| *alpha *= factor);
    shade.choose(most, spans, &mut kept);
    kept
}

/// Light and lengths of kept samples are the first of every ray.
fn in_front(rig: &Rig, arrays: &Arrays, shade: &Shade, visited: &[Span], kept: &[Span]) {
    let (light, along) = (
        rig.gpu.read(&arrays.light).unwrap(),
        rig.gpu.read(&arrays.along).unwrap(),
    );
    let place = |(from, to): (&Span, &Span)| {
        let shift = from.first - to.first;
        (to.first..to.end).map(move |sample| shift + sample)
    };
    let places: Vec<usize> = visited.iter().zip(kept).flat_map(place).collect();
    let row = |array: &[f32], row: usize| {
        places
            .iter()
            .map(|at| array[row * CAPACITY + at])
            .collect::<Vec<_>>()
    };
    let pairs = shade.tau.iter().zip(&shade.raw);
    let tau: Vec<f32> = pairs
        .map(|(tau, raw)| if *raw < RAW_LIMIT { *tau } else { 0.0 })
        .collect();
    assert!(tau.contains(&0.0));
    let samples = &shade.samples;
    let rows = [
        ("tau", row(&light, 0), &tau),
        ("alpha", row(&light, 1), &shade.alpha),
        ("distance", row(&along, 0), &samples.t),
        ("length", row(&along, 1), &samples.delta),
        ("place", row(&along, 2), &samples.place),
    ];
    for (name, found, expected) in rows {
        let pairs = found.iter().zip(expected);
        let errors = pairs.map(|(found, expected)| (found - expected).abs() / expected.abs().max(1e-30));
        let error = errors.fold(0.0, f32::max);
        println!("{name}: largest relative error {error:.1e}");
        assert!(error < TOLERANCE, "{name}: {error}");
    }
    let passes = &shade.transmittance[..places.len()];
    agree("transmittance", &row(&light, 2), passes, TOLERANCE);
    let all = visited.last().map_or(0, |span| span.end);
    let mut rest = light.chunks(CAPACITY).flat_map(|row| &row[all..]);
    assert!(rest.all(is_untouched));
}

/// The list of kept samples.
fn listed(rig: &Rig, kernels: &Light, spans: [&[Span]; 2], shown: &Array<u32>, kept: &[u32]) {
    let spans = rig.gpu.filled("spans", &rows_of_spans(spans)).unwrap();
    let origin = rig.gpu.filled("origin", &[77_u32; CAPACITY]).unwrap();
    let run = kernels.kept(rig.batch(), &spans, shown, &origin);
    rig.gpu.submit(|recorder| run.unwrap().record(recorder));
    let origin = rig.gpu.read(&origin).unwrap();
    assert_eq!(&origin[..kept.len()], kept);
    assert!(origin[kept.len()..].iter().all(|x| *x == 77));
}

#[test]
fn raw_densities_that_are_not_finite_are_told_and_give_finite_light() {
    let test = "raw_densities_that_are_not_finite_are_told_and_give_finite_light";
    for (at, bad, expected) in [
        (3, f32::NAN, vec![faults::DENSITY]),
        (90, f32::INFINITY, vec![0]),
        (90, f32::NEG_INFINITY, vec![0]),
        (90, 1e9, vec![]),
    ] {
        let (mut shade, before) = visited();
        shade.raw.iter_mut().for_each(|raw| *raw = raw.clamp(-1e3, 1e3));
        shade.raw[at] = bad;
        let Some(rig) = Rig::new(test, SIZE, [0, 0, RAYS as u32]) else {
            return;
        };
        let kernels = Light::new(&rig.gpu).unwrap();
        let arrays = Arrays::new(&rig, &shade, &spans());
        let shown = rig.gpu.zeros("shown", SIZE.shown_words()).unwrap();
        let front = rig.filled(&before);
        let chosen = SIZE.extent(3);
        let chosen = rig.gpu.uniform("chosen", chosen).unwrap();
        let run = kernels.opacity(rig.batch(), &chosen, arrays.columns(), &front, &shown);
        rig.gpu.submit(|recorder| run.record(recorder));
        assert_eq!(rig.faulty(), expected, "{bad}");
        let light = rig.gpu.read(&arrays.light).unwrap();
        assert!(light.iter().all(|x| x.is_finite()), "{bad}");
    }
}
