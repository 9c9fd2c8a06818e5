//! Focal lengths from pairs.

use super::*;

/// Fundamental matrices of pairs of one camera that moves and rotates freely.
fn pairs(
    count: u64,
    sigma_px: f64,
    camera: &Camera,
    layout: Layout,
    truth: impl Fn(&mut Rng) -> Pose,
) -> Vec<(Matrix3<f64>, usize)> {
    let guess = Camera {
        fx_px: 1200.0,
        fy_px: 1200.0,
        ..*camera
    };
    let pairs = (0..count).map(|seed| {
        let truth = truth(&mut Rng::new(seed));
        let found = views(truth, layout, 150, sigma_px, seed, camera).verified(&guess, FocalKnown::Guessed);
        (found.fundamental.unwrap(), found.inliers.len())
    });
    pairs.collect()
}

fn free_motion(rng: &mut Rng) -> Pose {
    let mut number = |size: f64| (rng.unit_f64() - 0.5) * size;
    let turn = [number(0.4), number(0.4), number(1.0)];
    pose(turn, [number(4.0), number(4.0), number(2.0)])
}

#[test]
fn the_focal_length_comes_back_from_a_guess_far_off() {
    let outside = Camera {
        cx_px: -200.0,
        cy_px: 900.0,
        ..camera()
    };
    for (name, camera) in [
        ("centred", camera()),
        ("principal point outside the photo", outside),
    ] {
        for (sigma_px, limit) in [(0.0, 1e-4), (0.5, 0.02), (1.0, 0.04)] {
            let pairs = pairs(20, sigma_px, &camera, Layout::Deep, free_motion);
            let guess = Camera {
                fx_px: 450.0,
                fy_px: 450.0,
                ..camera
            };
            let got = focal_from_pairs(&pairs, &guess).unwrap();
            assert!((got / 900.0 - 1.0).abs() < limit, "{name}, {sigma_px} px: {got}");
        }
    }
}

/// [e]x H of a pure rotation is essential at the true focal length for any e.
#[test]
fn turns_give_the_focal_length_or_none() {
    let turns = |rng: &mut Rng| pose([rng.unit_f64() * 0.2, 0.1, 0.1], [0.0; 3]);
    for (sigma_px, limit) in [(0.0, 1e-3), (0.5, 0.05)] {
        let got = focal_from_pairs(&pairs(12, sigma_px, &camera(), Layout::Deep, turns), &camera());
        assert!(
            got.is_none_or(|got| (got / 900.0 - 1.0).abs() < limit),
            "{sigma_px} px: {got:?}"
        );
    }
}

#[test]
fn pairs_that_do_not_determine_the_focal_length_say_so() {
    // Parallel axes: E is essential at every focal length. Planes: F is any of a family.
    let parallel = |rng: &mut Rng| {
        pose(
            [0.0, 0.0, rng.unit_f64()],
            [1.0 + rng.unit_f64(), rng.unit_f64(), 0.0],
        )
    };
    for sigma_px in [0.0, 0.5] {
        let got = focal_from_pairs(&pairs(12, sigma_px, &camera(), Layout::Deep, parallel), &camera());
        assert_eq!(got, None, "parallel axes, {sigma_px} px");
        let got = focal_from_pairs(
            &pairs(12, sigma_px, &camera(), Layout::Plane, free_motion),
            &camera(),
        );
        assert_eq!(got, None, "planes, {sigma_px} px");
    }
    assert_eq!(focal_from_pairs(&[], &camera()), None);
    assert_eq!(focal_from_pairs(&[(Matrix3::zeros(), 100)], &camera()), None);
    assert_eq!(
        focal_from_pairs(&[(Matrix3::from_element(f64::NAN), 100)], &camera()),
        None
    );
}
