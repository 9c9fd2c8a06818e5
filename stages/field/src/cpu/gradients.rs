//! Gradients against central differences in f64. Inputs are random and away from the kinks of ReLU and clamps.

use super::composite::{LOGIT_LIMIT, RAW_LIMIT, Ray, colour, colour_slope};
use super::encode::{Lookup, Points, Scatter, Shape};
use super::math::{exp, one_minus_exp_neg};
use super::net::{Net, Slopes};
use super::simd::{Block, InstructionSet, LANES, Run, Stripe, flat, flat_mut};
use crate::rng::{Purpose, random_numbers};

/// f32 sums of some tens of terms against f64: 24 bits less rounding of each term.
const F32_TOLERANCE: f64 = 2e-5;

fn random(len: usize, stream: u64) -> Vec<f32> {
    let mut rng = random_numbers(5, Purpose::Networks, 0, stream);
    (0..len).map(|_| rng.unit_f32() * 2.0 - 1.0).collect()
}

/// The slope of `f` in coordinate `index`.
fn slope(f: impl Fn(&[f64]) -> f64, at: &[f64], index: usize) -> f64 {
    let step = 1e-6;
    let moved = |by: f64| {
        let mut at = at.to_vec();
        at[index] += by;
        f(&at)
    };
    (moved(step) - moved(-step)) / (2.0 * step)
}

fn close(name: &str, index: usize, found: f32, expected: f64) {
    let error = (f64::from(found) - expected).abs();
    assert!(
        error < F32_TOLERANCE * (1.0 + expected.abs()),
        "{name} {index}: {found} against {expected}"
    );
}

const S: usize = 12;
const SLOPE: [f32; 3] = [0.7, -0.3, 0.9];
const BEHIND: [f32; 3] = [0.2, 0.5, 0.8];
const DISTORTION: [f32; 2] = [0.05, 0.02];

/// g . C + distortion loss of one ray in f64. `at` is tau, then colours.
fn ray_loss(at: &[f64], place: &[f32]) -> f64 {
    let (tau, rgb) = at.split_at(S);
    let mut left = 1.0;
    let (mut loss, mut weights) = (0.0, vec![]);
    for i in 0..S {
        let weight = left * -(-tau[i]).exp_m1();
        loss += (0..3)
            .map(|c| f64::from(SLOPE[c]) * weight * rgb[3 * i + c])
            .sum::<f64>();
        left *= (-tau[i]).exp();
        weights.push(weight);
    }
    loss += (0..3)
        .map(|c| f64::from(SLOPE[c]) * left * f64::from(BEHIND[c]))
        .sum::<f64>();
    let [strength, cell] = DISTORTION.map(f64::from);
    for i in 0..S {
        for j in 0..S {
            let apart = (f64::from(place[i]) - f64::from(place[j])).abs();
            loss += strength * weights[i] * weights[j] * apart;
        }
        loss += strength * weights[i] * weights[i] * cell / 3.0;
    }
    loss
}

#[test]
fn compositing_sends_back_the_slopes_of_the_f64_twin() {
    for thickness in [1e-6_f32, 0.05, 0.5, 3.0] {
        let tau: Vec<f32> = random(S, 1).iter().map(|x| thickness * (1.0 + 0.9 * x)).collect();
        let rgb: Vec<f32> = random(3 * S, 2).iter().map(|x| 0.5 + 0.4 * x).collect();
        let place: Vec<f32> = (0..S).map(|i| (i as f32 + 0.5) / S as f32).collect();
        let alpha: Vec<f32> = tau.iter().map(|tau| one_minus_exp_neg(*tau)).collect();
        let mut depth = 0.0;
        let transmittance: Vec<f32> = tau
            .iter()
            .map(|tau| {
                let before = exp(-depth);
                depth += tau;
                before
            })
            .collect();
        let colours: Vec<[f32; 4]> = rgb.chunks(3).map(|c| [c[0], c[1], c[2], 0.0]).collect();
        let ray = Ray {
            alpha: &alpha,
            transmittance: &transmittance,
            rgb: &colours,
            place: &place,
        };
        let (mut d_tau, mut d_rgb) = (vec![0.0; S], vec![[0.0; 4]; S]);
        ray.spread(SLOPE, BEHIND, DISTORTION, &mut d_tau, &mut d_rgb);
        let at: Vec<f64> = tau.iter().chain(&rgb).map(|x| f64::from(*x)).collect();
        for i in 0..S {
            let name = format!("tau {thickness}");
            close(&name, i, d_tau[i], slope(|at| ray_loss(at, &place), &at, i));
            for c in 0..3 {
                close(
                    &name,
                    i,
                    d_rgb[i][c],
                    slope(|at| ray_loss(at, &place), &at, S + 3 * i + c),
                );
            }
        }
    }
}

#[test]
fn one_sample_of_optical_depth_ln_2_shows_half_its_colour() {
    let ray = Ray {
        alpha: &[0.5],
        transmittance: &[1.0],
        rgb: &[[0.8, 0.4, 0.0, 0.0]],
        place: &[0.5],
    };
    let found = ray.gather();
    assert_eq!((found.rgb, found.left), ([0.4, 0.2, 0.0], 0.5));
    let empty = Ray {
        alpha: &[],
        transmittance: &[],
        rgb: &[],
        place: &[],
    };
    assert_eq!(empty.gather().left, 1.0);
}

#[test]
fn compositing_keeps_energy_at_the_extremes() {
    for tau in [
        0.0,
        f32::MIN_POSITIVE / 2.0,
        1e-8,
        1e-3,
        1.0,
        88.0,
        104.0,
        1e20,
        f32::MAX / 65.0,
    ] {
        let alpha = vec![one_minus_exp_neg(tau); 64];
        let transmittance: Vec<f32> = (0..64).map(|i| exp(-(i as f32 * tau))).collect();
        let ray = Ray {
            alpha: &alpha,
            transmittance: &transmittance,
            rgb: &[[1.0; 4]; 64],
            place: &[0.5; 64],
        };
        let found = ray.gather();
        assert!(
            (found.rgb[0] + found.left - 1.0).abs() < 1e-5,
            "tau {tau}: {} + {}",
            found.rgb[0],
            found.left
        );
        let (mut d_tau, mut d_rgb) = (vec![0.0; 64], vec![[0.0; 4]; 64]);
        ray.spread([1.0; 3], [0.0; 3], [0.1, 0.1], &mut d_tau, &mut d_rgb);
        assert!(
            d_tau.iter().all(|slope| slope.is_finite()),
            "tau {tau}: {d_tau:?}"
        );
    }
}

#[test]
fn a_colour_has_the_slope_of_the_sigmoid_and_none_beyond_its_limit() {
    for logit in [-9.0_f32, -1.0, 0.0, 0.3, 5.0] {
        let f = |at: &[f64]| 1.0 / (1.0 + (-at[0]).exp());
        close(
            "colour",
            0,
            colour_slope(logit, colour(logit)),
            slope(f, &[f64::from(logit)], 0),
        );
    }
    for logit in [LOGIT_LIMIT, -LOGIT_LIMIT, 1e30, f32::INFINITY] {
        assert_eq!(colour_slope(logit, colour(logit)), 0.0, "{logit}");
        assert!((0.0..=1.0).contains(&colour(logit)), "{logit}");
    }
    assert!(exp(RAW_LIMIT).is_finite());
}

/// Sum of outputs times `d` of a net in f64. `at` is the input rows, then the weights layer by layer.
fn net_loss(net: &Net, rows: usize, d: &[f32], at: &[f64]) -> f64 {
    let (mut x, mut weights) = (
        at[..rows * net.layers[0].inputs].to_vec(),
        &at[rows * net.layers[0].inputs..],
    );
    for (index, layer) in net.layers.iter().enumerate() {
        let (here, later) = weights.split_at(layer.inputs * layer.outputs);
        let mut y = vec![0.0; rows * layer.outputs];
        for (x, y) in x.chunks(layer.inputs).zip(y.chunks_mut(layer.outputs)) {
            for (x, row) in x.iter().zip(here.chunks(layer.outputs)) {
                row.iter().zip(&mut *y).for_each(|(w, y)| *y += x * w);
            }
            if index + 1 < net.layers.len() {
                y.iter_mut().for_each(|y| *y = y.max(0.0));
            }
        }
        (x, weights) = (y, later);
    }
    x.iter().zip(d).map(|(y, d)| y * f64::from(*d)).sum()
}

#[test]
fn a_network_sends_back_the_slopes_of_the_f64_twin() {
    let rows = 16;
    let mut net = Net::new(&[16, 32, 32, 16]);
    net.randomise(&mut random_numbers(3, Purpose::Networks, 0, 9));
    let mut input = vec![Block::default(); rows];
    flat_mut(&mut input).copy_from_slice(&random(rows * LANES, 4));
    let mut d = vec![Block::default(); rows];
    flat_mut(&mut d).copy_from_slice(&random(rows * LANES, 6));
    let at: Vec<f64> = flat(&input)
        .iter()
        .chain(net.layers.iter().flat_map(|layer| flat(&layer.weights)))
        .map(|x| f64::from(*x))
        .collect();
    let slopes: Vec<f64> = (0..at.len())
        .step_by(7)
        .map(|index| slope(|at| net_loss(&net, rows, flat(&d), at), &at, index))
        .collect();
    let (mut activations, mut gradients) = (vec![], vec![]);
    net.shape_gradients(&mut gradients);
    net.forward(InstructionSet::best(), &input, &mut activations);
    let mut back = Slopes::default();
    back.rows.clone_from(&d);
    net.backward(
        InstructionSet::best(),
        &input,
        &activations,
        &mut back,
        &mut gradients,
    );
    let found: Vec<f32> = flat(&back.rows)
        .iter()
        .chain(gradients.iter().flat_map(|layer| flat(layer)))
        .copied()
        .collect();
    for (index, expected) in (0..at.len()).step_by(7).zip(slopes) {
        close("network", index, found[index], expected);
    }
}

/// Features of one level are linear in its table: the transpose must satisfy <A t, d> = <t, A^T d>.
#[test]
fn scatter_is_the_transpose_of_lookup() {
    let level = InstructionSet::best();
    let coordinates: Vec<Vec<f32>> = (0..3)
        .map(|axis| random(32, axis).iter().map(|x| x * 0.5 + 0.5).collect())
        .collect();
    let points = Points {
        x: &coordinates[0],
        y: &coordinates[1],
        z: &coordinates[2],
    };
    for resolution in [3, 50] {
        let shape = Shape::new(resolution, 10);
        let table = random(shape.entries as usize * 4, 8);
        let (mut rows, mut d) = (vec![Block::default(); 32], vec![Block::default(); 32]);
        flat_mut(&mut d).copy_from_slice(&random(32 * LANES, 9));
        let mut gradient = vec![0.0; table.len()];
        let (width, stride, first) = (1, LANES, 8);
        level.run(Lookup::<4> {
            shape,
            table: &table,
            points,
            to: Stripe::cut(&mut rows, width, 4).remove(first / 4),
        });
        level.run(Scatter::<4> {
            shape,
            gradient: &mut gradient,
            points,
            rows: &d,
            stride,
            first,
        });
        let dot = |a: &[f32], b: &[f32]| {
            a.iter()
                .zip(b)
                .map(|(a, b)| f64::from(*a) * f64::from(*b))
                .sum::<f64>()
        };
        let (one, other) = (dot(flat(&rows), flat(&d)), dot(&table, &gradient));
        assert!((one - other).abs() < 1e-4, "{resolution}: {one} against {other}");
    }
}

/// On a table that holds the corner's own coordinates, trilinear lookup returns the position.
#[test]
fn lookup_of_a_linear_table_is_exact_also_at_the_far_corner() {
    let shape = Shape::new(4, 10);
    assert!(shape.dense && shape.entries == 125);
    let table: Vec<f32> = (0..125)
        .flat_map(|corner| {
            [
                (corner % 5) as f32,
                (corner / 5 % 5) as f32,
                (corner / 25) as f32,
                1.0,
            ]
        })
        .collect();
    let mut x = vec![0.5; LANES];
    x[..7].copy_from_slice(&[0.0, 1.0, 0.3, 1.0 - f32::EPSILON, f32::NAN, 7.0, -3.0]);
    let (y, z) = (vec![1.0; LANES], vec![0.25; LANES]);
    let points = Points { x: &x, y: &y, z: &z };
    let mut rows = vec![Block::default(); LANES];
    InstructionSet::best().run(Lookup::<4> {
        shape,
        table: &table,
        points,
        to: Stripe::cut(&mut rows, 1, 4).remove(0),
    });
    for (lane, expected) in [0.0, 4.0, 1.2, 4.0, 0.0, 4.0, 0.0, 2.0].into_iter().enumerate() {
        let [fx, fy, fz, one, ..] = rows[lane].0;
        assert!(
            (fx - expected).abs() < 1e-5,
            "x = {}: {fx} against {expected}",
            x[lane]
        );
        assert_eq!([fy, fz, one], [4.0, 1.0, 1.0], "x = {}", x[lane]);
    }
}
