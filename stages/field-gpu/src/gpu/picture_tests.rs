//! Rays of a picture against the CPU.

use super::array::Part;
use super::light::Light;
use super::light_tests::{
    Arrays, CAPACITY, NO_RAY, RAYS, SIZE, SLOTS, directions, harmonics, spans, visited,
};
use super::picture::{DEEP, PICTURE, Picture, STATE};
use super::rig::{Rig, TOLERANCE, UNTOUCHED, agree, columns};
use super::testing::numbers;
use marf_field::cpu::composite::{OPAQUE, colour};
use marf_field::cpu::simd::InstructionSet;
use marf_field::shade::{Shade, Span};

/// The row of a ray's state with the remaining transmittance.
const LEFT: usize = 5;

const HALF_SIDE: f32 = 3.5;

/// `[STATE][SLOTS]` after one more round, as `render::Gather`. `before` is that of the round.
fn painted(state: &mut [f32], shade: &mut Shade, spans: &[Span], rgb: &[f32]) {
    let before = state[..RAYS].to_vec();
    shade.opacities(InstructionSet::best(), spans, &before);
    for (ray, span) in spans.iter().enumerate() {
        let at = |row: usize| row * SLOTS + ray;
        state[at(0)] += shade.tau[span.first..span.end].iter().sum::<f32>();
        for sample in (span.first..span.end).take_while(|sample| shade.transmittance[*sample] >= OPAQUE) {
            let weight = shade.transmittance[sample] * shade.alpha[sample];
            for channel in 0..3 {
                let row = at(1 + channel);
                state[row] = weight.mul_add(rgb[3 * sample + channel], state[row]);
            }
            state[at(4)] = weight.mul_add(shade.samples.t[sample], state[at(4)]);
            state[at(LEFT)] = shade.transmittance[sample] - weight;
        }
        if state[at(0)] > DEEP {
            state[at(LEFT)] = state[at(LEFT)].min(OPAQUE * 0.5);
        }
    }
}

/// `[PICTURE][SLOTS]`, as `render::Walk::pixel`.
fn finished(state: &[f32], directions: &[[f32; 4]], background: Option<&[f32]>) -> Vec<f32> {
    let mut picture = vec![UNTOUCHED; PICTURE * SLOTS];
    for ray in 0..RAYS {
        let mut put = |row: usize, value: f32| picture[row * SLOTS + ray] = value;
        if ray == NO_RAY {
            (0..PICTURE).for_each(|row| put(row, 0.0));
            continue;
        }
        let row = |row: usize| state[row * SLOTS + ray];
        let harmonics = harmonics(&directions[ray]);
        for channel in 0..3 {
            let logit = |background: &[f32]| {
                let row = background[16 * channel..].iter().zip(&harmonics);
                row.fold(0.0_f32, |sum, (a, b)| a.mul_add(*b, sum))
            };
            let behind = background.map_or(0.0, |background| colour(logit(background)));
            put(channel, row(LEFT).mul_add(behind, row(1 + channel)));
        }
        let opacity = (1.0 - row(LEFT)).clamp(0.0, 1.0);
        let depth = row(4) / opacity * HALF_SIDE;
        put(3, opacity);
        put(
            4,
            if opacity > 0.0 && depth.is_finite() {
                depth
            } else {
                0.0
            },
        );
    }
    picture
}

#[test]
fn two_rounds_of_a_picture_are_those_of_the_cpu() {
    let test = "two_rounds_of_a_picture_are_those_of_the_cpu";
    let in_use = [CAPACITY as u32, CAPACITY as u32, RAYS as u32];
    let Some(rig) = Rig::new(test, SIZE, in_use) else {
        return;
    };
    let (light, picture) = (
        Light::new(&rig.gpu).unwrap(),
        Picture::new(&rig.gpu, HALF_SIDE).unwrap(),
    );
    let ((mut shade, _), spans, all) = (visited(), spans(), directions());
    shade.samples.delta.iter_mut().for_each(|delta| *delta *= 64.0);
    let colours: Vec<f32> = numbers(3 * shade.raw.len(), 61).iter().map(|x| x.abs()).collect();
    let weights = numbers(48, 62);
    let arrays = Arrays::new(&rig, &shade, &spans);
    let rgb = rig.filled(&columns(&colours, 3, CAPACITY, f32::NAN));
    let (state, shown) = (
        rig.filled(&[f32::NAN; STATE * SLOTS]),
        rig.gpu.zeros("shown", SIZE.shown_words()).unwrap(),
    );
    let chosen = SIZE.extent(0);
    let chosen = rig.gpu.uniform("chosen", chosen).unwrap();
    let opacity = light.opacity(rig.batch(), &chosen, arrays.columns(), &state, &shown);
    let [begin, paint] = picture
        .paint(rig.batch(), arrays.columns(), (&rgb).into(), &shown, &state)
        .unwrap();
    rig.gpu.submit(|recorder| begin.record(recorder));
    let mut expected = vec![0.0; STATE * SLOTS];
    expected[LEFT * SLOTS..].fill(1.0);
    assert_eq!(rig.gpu.read(&state).unwrap(), expected);
    for round in 0..2 {
        rig.gpu.submit(|recorder| opacity.record(recorder));
        // The samples that show are the first ones of the visited.
        rig.gpu
            .write(&arrays.spans, 3 * SLOTS, &rig.gpu.read(&shown).unwrap()[..SLOTS]);
        rig.gpu.submit(|recorder| paint.record(recorder));
        painted(&mut expected, &mut shade, &spans, &colours);
        let found = rig.gpu.read(&state).unwrap();
        for (row, (found, expected)) in found.chunks(SLOTS).zip(expected.chunks(SLOTS)).enumerate() {
            // Some rays are 1e30 deep. They would hide all others.
            let shallow = |row: &[f32]| {
                row.iter()
                    .map(|x| if *x < 100.0 { *x } else { 1.0 })
                    .collect::<Vec<_>>()
            };
            agree(
                &format!("paint {round}, row {row}"),
                &shallow(found),
                &shallow(expected),
                TOLERANCE,
            );
        }
    }
    let deep = expected[..RAYS].iter().filter(|depth| **depth > DEEP).count();
    assert!(deep > 3 && deep < RAYS - 5, "{deep} of {RAYS} rays are opaque");
    let directions = rig.gpu.filled("directions", &all).unwrap();
    let background = rig.filled(&weights);
    let behind = Some(Part::from(&background));
    for (behind, numbers) in [(None, None), (behind, Some(weights.as_slice()))] {
        let pixels = rig.filled(&[UNTOUCHED; PICTURE * SLOTS]);
        let run = picture
            .finish(rig.batch(), &directions, behind, &state, &pixels)
            .unwrap();
        rig.gpu.submit(|recorder| run.record(recorder));
        let expected = finished(&expected, &all, numbers);
        let rows = expected.chunks(SLOTS).enumerate();
        let found = rig.gpu.read(&pixels).unwrap();
        for ((row, expected), found) in rows.zip(found.chunks(SLOTS)) {
            // Depth is a quotient of two sums.
            agree(&format!("finish, row {row}"), found, expected, 2.0 * TOLERANCE);
        }
    }
}

#[test]
fn a_ray_that_met_nothing_has_no_depth_and_a_quotient_that_is_not_finite_is_none() {
    let test = "a_ray_that_met_nothing_has_no_depth_and_a_quotient_that_is_not_finite_is_none";
    let Some(rig) = Rig::new(test, SIZE, [0, 0, 4]) else {
        return;
    };
    let picture = Picture::new(&rig.gpu, 2.0).unwrap();
    // Nothing, a distance without opacity, a sliver at a huge distance, more than all.
    let mut numbers = vec![0.0; STATE * SLOTS];
    numbers[4 * SLOTS..][..4].copy_from_slice(&[0.0, 5.0, 3e38, 1.0]);
    numbers[LEFT * SLOTS..][..4].copy_from_slice(&[1.0, 1.0, 1.0 - 6e-8, -0.5]);
    let (state, pixels) = (rig.filled(&numbers), rig.filled(&[UNTOUCHED; PICTURE * SLOTS]));
    let directions = rig
        .gpu
        .filled("directions", &[[0.0, 0.0, 1.0, 1.0]; SLOTS])
        .unwrap();
    let run = picture
        .finish(rig.batch(), &directions, None, &state, &pixels)
        .unwrap();
    rig.gpu.submit(|recorder| run.record(recorder));
    let found = rig.gpu.read(&pixels).unwrap();
    assert_eq!(found[4 * SLOTS..][..5], [0.0, 0.0, 0.0, 2.0, UNTOUCHED]);
    assert_eq!((found[3 * SLOTS], found[3 * SLOTS + 3]), (0.0, 1.0));
}
