//! Relative poses.

use super::*;

#[test]
fn motions_come_back_in_every_direction_within_what_noise_allows() {
    for t in [
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, -1.0],
        [0.0, 0.0, 1.0],
        [0.6, -0.3, -0.5],
    ] {
        for (sigma_px, limit_deg) in [(0.0, 1e-6), (0.1, 0.1), (1.0, 1.0)] {
            let views = views(
                pose([0.03, -0.05, 0.1], t),
                Layout::Deep,
                200,
                sigma_px,
                16,
                &camera(),
            );
            let found = views.relative_pose(&camera()).unwrap();
            let [turn, direction] = views.errors_deg(&found);
            assert!(
                turn < limit_deg && direction < 3.0 * limit_deg,
                "{t:?} {sigma_px} px: {turn} {direction}"
            );
            assert_eq!(found.kind, RelativePoseKind::General, "{t:?} {sigma_px} px");
            let forward = t[2].abs() / Vector3::from(t).norm();
            assert!((found.forward - forward).abs() < 0.05, "{t:?}: {}", found.forward);
        }
    }
}

#[test]
fn a_plane_has_the_right_pose_with_and_without_points_off_it() {
    for layout in [Layout::Plane, Layout::AlmostPlane] {
        for t in [[1.0, 0.1, -0.1], [0.1, 0.2, -1.5]] {
            for sigma_px in [0.0, 0.5] {
                let views = views(pose([0.02, -0.12, 0.03], t), layout, 200, sigma_px, 17, &camera());
                let found = views.relative_pose(&camera()).unwrap();
                let [turn, direction] = views.errors_deg(&found);
                let limit_deg = 1e-6 + 2.0 * sigma_px;
                assert!(
                    turn < limit_deg && direction < 3.0 * limit_deg,
                    "{layout:?} {t:?} {sigma_px} px: {turn} {direction}"
                );
                assert_eq!(
                    found.kind,
                    RelativePoseKind::Planar,
                    "{layout:?} {t:?} {sigma_px}"
                );
            }
        }
    }
}

#[test]
fn a_turn_on_the_spot_is_a_rotation_at_any_noise() {
    for turn in [[0.05, 0.15, -0.02], [0.0, 0.0, 0.5], [0.3, 0.0, 0.0]] {
        for sigma_px in [0.0, 0.1, 0.5, 1.0] {
            for seed in 0..5 {
                let views = views(pose(turn, [0.0; 3]), Layout::Deep, 150, sigma_px, seed, &camera());
                let found = views.relative_pose(&camera()).unwrap();
                assert_eq!(
                    found.kind,
                    RelativePoseKind::Rotation,
                    "{turn:?} {sigma_px} px {seed}: {found:?}"
                );
                assert_eq!(found.cam2_from_cam1.translation, Vector3::zeros());
                let error =
                    log_so3(&(found.cam2_from_cam1.rotation.transpose() * views.truth.rotation)).norm();
                assert!(
                    error < 1e-9 + 6e-4 * sigma_px,
                    "{turn:?} {sigma_px} px {seed}: {error:e}"
                );
            }
        }
    }
}

#[test]
fn a_small_baseline_is_no_rotation_once_its_parallax_clears_the_noise() {
    // Depths 4 to 12, focal 900: a baseline of b spreads parallax over 150 b px.
    for (baseline, sigma_px, rotation) in [
        (0.1, 0.5, false),
        (0.05, 0.5, false),
        (0.02, 0.1, false),
        (1e-2, 0.0, false),
        (1e-2, 1.0, true),
        (1e-5, 0.0, true),
        (1e-5, 0.5, true),
    ] {
        for seed in 0..5 {
            let truth = pose([0.02, -0.06, 0.03], [baseline, 0.1 * baseline, 0.0]);
            let found = views(truth, Layout::Deep, 150, sigma_px, seed, &camera())
                .relative_pose(&camera())
                .unwrap();
            let got = found.kind == RelativePoseKind::Rotation;
            assert_eq!(
                got, rotation,
                "baseline {baseline:e}, {sigma_px} px, seed {seed}: {:?}",
                found.kind
            );
        }
    }
}

#[test]
fn the_median_angle_is_that_of_the_rays() {
    let views = views(sideways(), Layout::Deep, 101, 0.0, 18, &camera());
    let angle = |i: usize| {
        let (p, q) = (
            camera().unproject(&views.a[i]).unwrap(),
            camera().unproject(&views.b[i]).unwrap(),
        );
        ray_angle_rad(&p, &(views.truth.rotation.transpose() * q), &Vector3::zeros())
    };
    let mut angles: Vec<f64> = (0..101).map(angle).collect();
    angles.sort_by(f64::total_cmp);
    let got = views.relative_pose(&camera()).unwrap().median_angle_rad;
    assert!((got - angles[50]).abs() < 1e-9, "{got} {}", angles[50]);
}

#[test]
fn the_same_photo_twice_is_no_motion() {
    let mut views = views(sideways(), Layout::Deep, 100, 0.0, 19, &camera());
    views.b.clone_from(&views.a);
    let found = views.relative_pose(&camera()).unwrap();
    assert_eq!(found.kind, RelativePoseKind::Rotation);
    assert!((found.cam2_from_cam1.rotation - Matrix3::identity()).norm() < 1e-9);
    assert!(found.median_angle_rad.is_finite());
}

#[test]
fn crops_and_zooms_of_one_picture_are_no_motion() {
    for (scale, shift) in [
        (1.0, [300.0, 0.0]),
        (1.0, [-250.0, 180.0]),
        (1.5, [-250.0, -190.0]),
        (0.4, [0.0; 2]),
    ] {
        for sigma_px in [0.0, 0.3] {
            for (seed, focal) in [(30, FocalKnown::Known), (31, FocalKnown::Guessed)] {
                let mut views = views(sideways(), Layout::Deep, 150, sigma_px, seed, &camera());
                let still = super::views(
                    pose([0.0; 3], [0.0; 3]),
                    Layout::Deep,
                    150,
                    sigma_px,
                    seed,
                    &camera(),
                );
                let cut = |q: &Vector2<f64>| q * scale + Vector2::from(shift);
                (views.a, views.b) = (still.a, still.b.iter().map(cut).collect());
                // Wrong matches that lie on the lines of a camera that passes a plane.
                views
                    .b
                    .iter_mut()
                    .take(8)
                    .for_each(|q| *q += 0.2 * Vector2::from(shift));
                let found = views.relative_pose_with(&camera(), focal).unwrap();
                assert_eq!(
                    found.kind,
                    RelativePoseKind::Rotation,
                    "{scale} {shift:?} {sigma_px} px {focal:?}"
                );
                assert_eq!(found.cam2_from_cam1.translation, Vector3::zeros());
            }
        }
    }
}

#[test]
fn a_turn_under_a_guessed_focal_length_is_a_rotation() {
    for factor in [0.4, 0.7, 1.5, 2.5] {
        for turn in [[0.0, 0.12, 0.0], [0.05, -0.1, 0.03]] {
            let truth = Camera::pinhole(1000, 750, 1000.0);
            let guess = Camera::pinhole(1000, 750, 1000.0 * factor);
            let views = views(pose(turn, [0.0; 3]), Layout::Deep, 200, 0.3, 32, &truth);
            let found = views.relative_pose_with(&guess, FocalKnown::Guessed).unwrap();
            assert_eq!(found.kind, RelativePoseKind::Rotation, "{factor} {turn:?}");
        }
    }
}

#[test]
fn a_plane_passed_under_a_guessed_focal_length_is_no_rotation() {
    // Straight down upon it, along it, and at a slant, with the 0.02 rad of sway that every drone or lander has.
    for t in [[0.0, 0.0, -1.5], [1.0, 0.0, 0.0], [0.3, 0.2, -1.0]] {
        for layout in [Layout::Plane, Layout::AlmostPlane] {
            for factor in [0.7, 1.0, 1.5] {
                let guess = Camera::pinhole(1000, 750, 900.0 * factor);
                let views = views(pose([0.02, -0.02, 0.01], t), layout, 200, 0.5, 33, &camera());
                let found = views.relative_pose_with(&guess, FocalKnown::Guessed).unwrap();
                assert_ne!(
                    found.kind,
                    RelativePoseKind::Rotation,
                    "{t:?} {layout:?} {factor}"
                );
            }
        }
    }
}
