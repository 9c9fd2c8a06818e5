//! The extremes of the kernels (`reference/kernels.md`, sections 5.1 to 5.3 and 5.6). The message holds the
//! value that breaks. Others are tested in `march.rs`, `gradients.rs`, `adam.rs`, `twins.rs`.

use super::adam::{Adam, Bias, Moments};
use super::composite::{Depths, ExpNeg, RAW_LIMIT, RAW_SHIFT, Ray, runs_away};
use super::encode::{Lookup, Points, Shape};
use super::march::{March, Samples, Steps};
use super::simd::{Block, InstructionSet, LANES, Run, Stripe};
use super::space::Bits;

const S: usize = 64;
const SLOPE: [f32; 3] = [0.7, -0.3, 0.9];
const BEHIND: [f32; 3] = [0.2, 0.5, 0.8];

fn shades() -> Vec<[f32; 4]> {
    let shade = |i: usize| [i as f32 / S as f32, 0.5, 1.0 - i as f32 / S as f32, 0.0];
    (0..S).map(shade).collect()
}

/// Colour before the background, and gradients of the raw densities, by the kernels.
fn composited(level: InstructionSet, raw: f32, dt: f32) -> Vec<f32> {
    let (mut tau, mut alpha) = ([0.0; S], [0.0; S]);
    let (raw, delta) = (&[raw; S], &[dt; S]);
    level.run(Depths {
        raw,
        delta,
        tau: &mut tau,
        alpha: &mut alpha,
    });
    let (mut transmittance, mut depth) = ([0.0; S], 0.0);
    for (before, tau) in transmittance.iter_mut().zip(tau) {
        *before = depth;
        depth += tau;
    }
    level.run(ExpNeg(&mut transmittance));
    let ray = Ray {
        alpha: &alpha,
        transmittance: &transmittance,
        rgb: &shades(),
        place: &[0.5; S],
    };
    let (mut d_tau, mut d_rgb) = ([0.0; S], [[0.0; 4]; S]);
    ray.spread(SLOPE, BEHIND, [0.0; 2], &mut d_tau, &mut d_rgb);
    let inside = |i: usize| {
        if raw[i] < RAW_LIMIT {
            d_tau[i] * tau[i]
        } else {
            0.0
        }
    };
    let mut found = ray.gather().rgb.to_vec();
    found.extend((0..S).map(inside));
    found
}

/// As [`composited`], in f64.
fn composited_in_f64(raw: f64, dt: f64) -> Vec<f64> {
    let tau = (raw.min(RAW_LIMIT.into()) + f64::from(RAW_SHIFT)).exp() * dt;
    let dot = |rgb: [f32; 4]| (0..3).map(|c| f64::from(SLOPE[c] * rgb[c])).sum::<f64>();
    let [r, g, b] = BEHIND;
    let left = |i: usize| (-tau * i as f64).exp();
    let weight = |i: usize| left(i) * -(-tau).exp_m1();
    let shades = shades();
    let colour = |c: usize| (0..S).map(|i| weight(i) * f64::from(shades[i][c])).sum();
    let mut found: Vec<f64> = (0..3).map(colour).collect();
    for i in 0..S {
        let behind: f64 = (i + 1..S).map(|j| weight(j) * dot(shades[j])).sum();
        let d_tau = left(i + 1) * dot(shades[i]) - behind - left(S) * dot([r, g, b, 0.0]);
        let inside = raw < f64::from(RAW_LIMIT);
        found.push(if inside { d_tau * tau } else { 0.0 });
    }
    found
}

/// The table of `reference/kernels.md`, section 5.1.
#[test]
fn compositing_stays_exact_in_every_case_that_breaks_the_product_form() {
    for (raw, dt) in [
        (0.0, 0.01),
        (-15.0, 0.001),
        (-70.0, 1e-4),
        (10.9, 0.01),
        (12.0, 0.01),
        (60.0, 0.01),
        (100.0, 0.01),
        (1.0, 0.0),
        (3.0, 1e10),
        (100.0, 1e10),
    ] {
        let expected = composited_in_f64(raw, dt);
        let found = composited(InstructionSet::best(), raw as f32, dt as f32);
        for (part, name) in [(0..3, "colour"), (3..S + 3, "gradient")] {
            // Thin rays are judged by what little they show, opaque ones by one.
            let largest = expected[part.clone()].iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            let scale = if raw > 10.0 || dt > 1.0 { 1.0 } else { largest };
            for i in part {
                let error = (f64::from(found[i]) - expected[i]).abs();
                assert!(
                    error <= 3e-6 * scale,
                    "raw {raw}, dt {dt}: {name} {i} is {}, in f64 {}",
                    found[i],
                    expected[i]
                );
            }
        }
        for level in InstructionSet::all() {
            assert_eq!(
                composited(level, raw as f32, dt as f32),
                found,
                "raw {raw}, dt {dt}: {level:?}"
            );
        }
    }
}

/// A NaN would come out opaque and -inf empty: both are counted before, and training stops there by name.
#[test]
fn a_raw_density_that_is_not_finite_is_counted_and_composites_to_finite_numbers() {
    for raw in [f32::NAN, -f32::NAN, f32::NEG_INFINITY, f32::INFINITY] {
        assert!(runs_away(raw), "{raw}");
        for level in InstructionSet::all() {
            let found = composited(level, raw, 0.01);
            assert!(
                found.iter().all(|value| value.is_finite()),
                "{raw} {level:?}: {found:?}"
            );
        }
    }
}

fn full(side: u32) -> Bits {
    let mut bits = Bits::new(side);
    bits.words.fill(u64::MAX);
    bits
}

fn walk(level: InstructionSet, steps: &Steps, bits: &Bits, origin: [f32; 3], direction: [f32; 3]) -> Samples {
    let mut samples = Samples::default();
    level.run(March {
        clearance: None,
        steps,
        bits,
        origin,
        direction,
        jitter: 0.0,
        first: 0,
        limit: usize::MAX,
        samples: &mut samples,
    });
    samples
}

/// Steps are counted in f64 and grow with the distance: within all that [`Config`] allows, f32 loses none.
#[test]
fn no_step_stalls_at_any_distance_and_length_that_may_be_set() {
    for (near, far, shortest, cone) in [
        (1e-4, 1e6, 1e-4, 1.0 / 1024.0),
        (10.0, 1e6, 1e-4, 1.0 / 1024.0),
        (1e-4, 1e6, 0.5, 0.25),
        (999.0, 1e6, 1e-4, 1.0 / 1024.0),
    ] {
        let steps = Steps::new(near, far, shortest, cone);
        let pair = steps.begin[..steps.count]
            .windows(2)
            .find(|pair| pair[0] >= pair[1]);
        assert_eq!(pair, None, "near {near}, shortest {shortest}, cone {cone}");
        assert!(
            f64::from(steps.begin[steps.count - 1]) > 0.7 * far,
            "{far}: {:?}",
            steps.begin.last()
        );
    }
}

/// No slab is cut, so no 0 * inf: directions of zeros, negative zeros and denormals find the cells they run through.
#[test]
fn a_ray_along_a_face_or_from_one_finds_the_cells_beside_it() {
    let steps = Steps::new(0.0625, 4.0, 0.0625, 0.0);
    let mut bits = Bits::new(16);
    // The cells on both sides of the face x = 0 of the contracted world: [-0.25, 0] and [0, 0.25] along x.
    for z in 0..16 {
        bits.set((z * 16 + 8) * 16 + 8);
    }
    for level in InstructionSet::all() {
        for zero in [0.0, -0.0, 1e-40, f32::MIN_POSITIVE] {
            for end in [1.0, -1.0] {
                let found = walk(level, &steps, &bits, [0.0, 0.0, 0.0], [zero, zero, end]);
                assert_eq!(found.len(), steps.count, "[{zero:e}, {zero:e}, {end}] {level:?}");
            }
        }
        // On the inner box's own face, inwards and outwards.
        for end in [1.0, -1.0] {
            let found = walk(level, &steps, &full(16), [1.0, 1.0, -1.0], [end, 0.0, 0.0]);
            assert_eq!(found.len(), steps.count, "{end} {level:?}");
            assert!(
                found.delta.iter().all(|delta| *delta > 0.0),
                "{end}: {:?}",
                found.delta
            );
        }
    }
}

/// Rust, AVX2 and AVX-512 convert these to different integers: they are cut to the box before.
#[test]
fn cells_of_numbers_that_have_none_are_those_of_the_border() {
    let steps = Steps::new(1.0, 17.0, 1.0, 0.0);
    for level in InstructionSet::all() {
        for bad in [
            f32::NAN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            1e20,
            -1e20,
            -0.3,
            f32::MAX,
        ] {
            for side in [16, 256] {
                let found = walk(level, &steps, &full(side), [bad, 0.2, 0.2], [0.0, 0.0, 1.0]);
                assert_eq!(found.len(), steps.count, "{bad} {level:?} {side}");
            }
        }
    }
}

/// ceil(scale) + 1 corners are one short where the scale is whole or x is 1: a level has resolution + 1 of them.
#[test]
fn the_far_corner_has_an_entry_at_every_resolution() {
    for level in InstructionSet::all() {
        for (resolution, log2_table) in [
            (1, 8),
            (4, 8),
            (16, 13),
            (31, 15),
            (32, 15),
            (255, 24),
            (1 << 20, 10),
        ] {
            let shape = Shape::new(resolution, log2_table);
            let mut table = vec![0.0; shape.entries as usize * 2];
            let side = u64::from(resolution) + 1;
            let far = u64::from(resolution);
            let entry = if shape.dense {
                far + side * (far + side * far)
            } else {
                let [y, z] = [2_654_435_761_u64, 805_459_861].map(|prime| far.wrapping_mul(prime));
                (far ^ y ^ z) % u64::from(shape.entries)
            };
            table[entry as usize * 2] = 1.0;
            let (at, mut rows) = (vec![1.0; LANES], vec![Block::default(); LANES]);
            level.run(Lookup::<2> {
                shape,
                table: &table,
                points: Points {
                    x: &at,
                    y: &at,
                    z: &at,
                },
                to: Stripe::cut(&mut rows, 1, 2).remove(0),
            });
            assert!(
                rows.iter().all(|row| row.0[0] == 1.0),
                "{shape:?} {level:?}: {:?}",
                rows[0]
            );
        }
    }
}

/// One gradient and 199 zeros, as in `reference/kernels.md`, section 5.6: distance moved, in step sizes.
fn moved(gradient: f32, count: u32, epsilon: f32) -> f32 {
    let (mut weights, mut moments) = (vec![0.0; 8], Moments::new(8, 4));
    moments.count.fill(count);
    for step in 0..200 {
        let now = if step == 0 { gradient } else { 0.0 };
        let mut gradient = [[now; 4], [0.0; 4]].concat();
        InstructionSet::best().run(Adam::<4> {
            weights: &mut weights,
            gradient: &mut gradient,
            moments: &mut moments,
            rate: 1.0,
            epsilon,
            decay: 0.0,
            bias: &Bias::default(),
        });
    }
    assert_eq!(
        (&weights[4..], moments.count[1]),
        (&[0.0; 4][..], count),
        "never touched"
    );
    -weights[0]
}

#[test]
fn an_entry_touched_once_moves_one_step_and_fades_below_epsilon() {
    // A dense pass moves it by 6 steps at first and by 10.5 after a thousand.
    for gradient in [1.0, 1e-3, 1e-6, 1e-9, 1e-12] {
        let first = moved(gradient, 0, 1e-15);
        assert!((first - 1.0).abs() < 2e-3, "gradient {gradient:e}: {first}");
        // Corrected for a thousand steps the moments of one are 0.1 g and 0.01 g^2: 0.1 / sqrt(0.01).
        let late = moved(gradient, 1000, 1e-15);
        assert!((late - 1.0).abs() < 2e-2, "gradient {gradient:e}: {late}");
    }
    for gradient in [1e-18, 1e-25, 1e-38, 1e-42] {
        let faded = moved(gradient, 0, 1e-15);
        assert!((0.0..2e-3).contains(&faded), "gradient {gradient:e}: {faded}");
    }
    // With the epsilon of training, rounding noise is below.
    assert!(moved(1e-15, 0, 1e-12) < 2e-3, "{}", moved(1e-15, 0, 1e-12));
}
