//! Pictures against the slow path: every step of every ray, one ray at a time.

use super::bundle::{Bundle, NearMatter};
use super::lattice::{Lattice, STRIP};
use super::*;
use crate::Field;
use crate::cpu::clearance::Clearance;
use crate::cpu::composite::{Gather, Ray};
use crate::cpu::march::{March, Samples, Steps};
use crate::cpu::simd::{InstructionSet, Run};
use crate::cpu::space::Bits;
use crate::frame::RayStart;
use crate::model::Model;
use crate::rng::{Purpose, random_numbers};
use crate::sh;
use crate::shade::{Shade, Span};
use crate::test_scene::{ball, ball_view, small, trained};

/// Behind [`OPAQUE`] a ray takes the colour found so far. The slow path takes the background.
const SLOW_TOLERANCE: f32 = 4e-4;

fn ball_field() -> Field {
    trained(ball(12, 24), &small(), 4, 300).field().unwrap()
}

fn picture(model: &Model, view: &crate::View, accuracy: Accuracy) -> Render {
    let viewpoint = Viewpoint {
        level: InstructionSet::best(),
        model,
        clearance: &Clearance::new(&model.bits),
        camera: &view.camera,
        world_from_cam: view.cam_from_world.inverse(),
        accuracy,
    };
    viewpoint.rows(0..view.camera.height)
}

fn walk(steps: &Steps, bits: &Bits, ray: &RayStart) -> Samples {
    let mut samples = Samples::default();
    InstructionSet::best().run(March {
        clearance: None,
        steps,
        bits,
        origin: ray.origin,
        direction: ray.direction,
        jitter: MIDDLE,
        first: 0,
        limit: usize::MAX,
        samples: &mut samples,
    });
    samples
}

/// The colour and opacity of one ray.
fn slow(model: &Model, ray: &RayStart) -> ([f32; 3], f32) {
    let level = InstructionSet::best();
    let mut shade = Shade::default();
    shade.samples = walk(&model.steps, &model.bits, ray);
    let spans = [Span {
        first: 0,
        end: shade.samples.len(),
    }];
    let harmonics = [sh::harmonics(ray.direction)];
    shade.densities(level, &model.weights);
    shade.opacities(level, &spans, &[0.0]);
    shade.colours(level, &model.weights, &spans, &harmonics);
    let found = level.run(Gather(Ray {
        alpha: &shade.alpha[..spans[0].end],
        transmittance: &shade.transmittance[..spans[0].end],
        rgb: &shade.rgb[..spans[0].end],
        place: &shade.samples.place[..spans[0].end],
    }));
    let behind = model.weights.behind(model.config.background, &harmonics[0]);
    let rgb = [0, 1, 2].map(|channel| found.left.mul_add(behind[channel], found.rgb[channel]));
    (rgb, 1.0 - found.left)
}

#[test]
fn an_exact_picture_is_that_of_the_slow_path() {
    let field = ball_field();
    let view = ball_view(0.7, 0.3, 21);
    let render = picture(&field.model, &view, Accuracy::EXACT);
    for pixel in 0..render.rgb.len() {
        let centre = [(pixel % 21) as f64 + 0.5, (pixel / 21) as f64 + 0.5];
        let ray = field
            .model
            .frame
            .ray(&view.camera, &view.cam_from_world.inverse(), centre);
        let (rgb, opacity) = slow(&field.model, &ray.unwrap());
        let apart = |a: f32, b: f32| (a - b).abs() > SLOW_TOLERANCE;
        let found = render.rgb[pixel];
        assert!(
            !(0..3).any(|channel| apart(found[channel], rgb[channel]))
                && !apart(render.opacity[pixel], opacity),
            "pixel {pixel}: {found:?}, {} and {rgb:?}, {opacity}",
            render.opacity[pixel]
        );
    }
}

#[test]
fn a_picture_stays_45_db_from_the_exact_one() {
    let field = ball_field();
    let view = ball_view(0.7, 0.3, 64);
    let [exact, found] =
        [Accuracy::EXACT, Accuracy::PICTURE].map(|accuracy| picture(&field.model, &view, accuracy));
    let pairs = exact.rgb.as_flattened().iter().zip(found.rgb.as_flattened());
    let sum: f64 = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum();
    let psnr = -10.0 * (sum / (3 * exact.rgb.len()) as f64).log10();
    assert!(psnr > 45.0, "{psnr} dB");
    let opacities = exact.opacity.iter().zip(&found.opacity);
    let apart: f64 = opacities.map(|(a, b)| f64::from(a - b).powi(2)).sum();
    let apart = (apart / exact.opacity.len() as f64).sqrt();
    assert!(apart < 0.02, "opacities are {apart} apart");
    assert!(found != exact, "nothing was saved");
}

#[test]
fn a_walk_near_matter_finds_what_a_walk_over_all_steps_finds() {
    let steps = Steps::new(0.05, 400.0, 0.02, 0.02);
    let mut rng = random_numbers(5, Purpose::Rays, 0, 0);
    let (mut near_steps, mut rays) = (0, 0);
    for share in [0.0, 1e-4, 1e-3, 1e-2, 1.0] {
        let mut bits = Bits::new(32);
        for cell in 0..32_usize.pow(3) {
            if rng.unit_f32() < share {
                bits.set(cell);
            }
        }
        let clearance = Clearance::new(&bits);
        for _ in 0..60 {
            let reach = [0.5, 3.0, 40.0][rng.below(3) as usize];
            let mut number = |size: f32| size * (2.0 * rng.unit_f32() - 1.0);
            let origin = [0; 3].map(|_| number(reach));
            let middle = [0; 3].map(|_| number(1.0));
            let bundle: Vec<RayStart> = (0..5)
                .map(|_| {
                    let toward = middle.map(|axis| axis + number(0.03));
                    let norm = toward.iter().map(|axis| axis * axis).sum::<f32>().sqrt();
                    let direction = toward.map(|axis| axis / norm);
                    RayStart { origin, direction }
                })
                .collect();
            let near = InstructionSet::best().run(NearMatter {
                steps: &steps,
                clearance: &clearance,
                bundle: Bundle::new(&bundle).unwrap(),
            });
            near_steps += near.count;
            rays += 1;
            for ray in &bundle {
                let (all, found) = (walk(&steps, &bits, ray), walk(&near, &bits, ray));
                assert_eq!(found.t, all.t, "share {share}, {ray:?}");
                assert_eq!(
                    (found.x, found.delta),
                    (all.x, all.delta),
                    "share {share}, {ray:?}"
                );
            }
        }
    }
    assert!(
        near_steps < rays * steps.count / 2,
        "{near_steps} of {}",
        rays * steps.count
    );
}

#[test]
fn empty_dense_and_stepless_fields_and_a_camera_in_matter_render_finite_numbers() {
    let whole = ball_field().model;
    let view = ball_view(0.7, 0.3, 19);
    let mut inside = view.clone();
    inside.cam_from_world.translation.fill(0.0);
    let empty = Model {
        bits: Bits::new(whole.bits.side),
        ..whole.clone()
    };
    let mut dense = whole.clone();
    dense.bits.words.fill(u64::MAX);
    let stepless = Model {
        steps: Steps::new(1.0, 1.0, 0.1, 0.1),
        ..whole.clone()
    };
    for (name, model) in [("empty", &empty), ("dense", &dense), ("stepless", &stepless)] {
        for view in [&view, &inside] {
            for accuracy in [Accuracy::EXACT, Accuracy::PICTURE] {
                let render = picture(model, view, accuracy);
                let numbers = render.rgb.as_flattened().iter().chain(&render.opacity);
                assert!(
                    numbers
                        .into_iter()
                        .all(|value| (-1e-6..=1.0 + 1e-5).contains(value)),
                    "{name}"
                );
                assert!(
                    render
                        .depth
                        .iter()
                        .all(|depth| depth.is_finite() && *depth >= 0.0),
                    "{name}"
                );
                let is_empty = render.opacity.iter().all(|opacity| *opacity == 0.0);
                assert_eq!(is_empty, name != "dense", "{name}");
            }
        }
    }
}

#[test]
fn knots_and_others_are_all_pixels_once_and_a_plane_is_interpolated_exactly() {
    for (width, height) in [(1, 1), (1, 8), (2, 3), (9, 6), (43, 8), (8, STRIP)] {
        let lattice = Lattice::new(width, height);
        let mut all = [lattice.knots(), lattice.others()].concat();
        all.sort_unstable();
        assert_eq!(all, (0..width * height).collect::<Vec<_>>(), "{width} x {height}");
        let plane = |pixel: u32| {
            [
                0.2 + 0.001 * (pixel % width) as f32,
                0.3 - 0.002 * (pixel / width) as f32,
                0.5,
            ]
        };
        let mut strip = Render::empty(width, height);
        for pixel in lattice.knots() {
            strip.rgb[pixel as usize] = plane(pixel);
            strip.depth[pixel as usize] = 2.0;
        }
        for pixel in lattice.others() {
            assert!(
                lattice.interpolate(&mut strip, pixel, 0.02),
                "{width} x {height}: {pixel}"
            );
            let (found, expected) = (strip.rgb[pixel as usize], plane(pixel));
            let close = (0..3).all(|channel| (found[channel] - expected[channel]).abs() < 1e-6);
            assert!(close, "{width} x {height}, {pixel}: {found:?} {expected:?}");
            assert!(
                !lattice.interpolate(&mut strip, pixel, 0.0),
                "nothing is alike to the bit"
            );
        }
    }
}

#[test]
fn knots_of_another_colour_opacity_or_depth_are_not_interpolated() {
    let lattice = Lattice::new(3, 8);
    let flat = Render {
        depth: vec![1.0; 24],
        ..Render::empty(3, 8)
    };
    assert!(lattice.interpolate(&mut flat.clone(), 1, 0.03));
    let change: [fn(&mut Render); 3] = [
        |strip| strip.rgb[2][1] = 0.04,
        |strip| strip.opacity[2] = 0.04,
        |strip| strip.depth[2] = 1.2,
    ];
    for change in change {
        let mut strip = flat.clone();
        change(&mut strip);
        assert!(!lattice.interpolate(&mut strip, 1, 0.03));
    }
}
