//! Verdicts on raw matches.

use super::*;

#[test]
fn true_matches_survive_up_to_half_and_random_ones_are_refused() {
    for focal in [FocalKnown::Known, FocalKnown::Guessed] {
        for (wrong, least) in [(0, 290), (150, 145), (270, 0), (285, 0), (300, 0)] {
            let views = views(sideways(), Layout::Deep, 300, 0.5, 3, &camera()).with_outliers(wrong, 4);
            let found = views.verified(&camera(), focal);
            let right = found.inliers.iter().filter(|m| m[0] >= wrong as u32).count();
            assert!(right >= least, "{focal:?}, {wrong} of 300 wrong: {right} found");
            // Beyond the reach of the trials (56 % wrong): all but a few of the kept matches are right, or no match
            // is kept.
            let false_ones = found.inliers.len() - right;
            assert!(
                false_ones <= 10,
                "{focal:?}, {wrong} of 300 wrong: {false_ones} false"
            );
            assert_eq!(
                found.kind == VerifiedKind::None,
                least == 0,
                "{focal:?}, {wrong} wrong: {found:?}"
            );
            assert_eq!(found.fundamental.is_some(), least > 0);
        }
    }
}

#[test]
fn noise_of_any_size_keeps_what_is_within_the_limit() {
    for (sigma_px, least) in [(0.0, 300), (0.1, 300), (1.0, 298), (5.0, 120)] {
        let views = views(sideways(), Layout::Deep, 300, sigma_px, 5, &camera());
        for focal in [FocalKnown::Known, FocalKnown::Guessed] {
            let found = views.verified(&camera(), focal);
            assert!(
                found.inliers.len() >= least,
                "{sigma_px} px, {focal:?}: {}",
                found.inliers.len()
            );
            assert_eq!(found.kind, VerifiedKind::General, "{sigma_px} px, {focal:?}");
        }
    }
}

#[test]
fn a_focal_length_wrong_by_two_leaves_the_fundamental_matrix_its_inliers() {
    let views = views(sideways(), Layout::Deep, 300, 0.5, 6, &camera());
    for factor in [0.5, 2.0] {
        let guess = Camera::pinhole(1000, 750, 900.0 * factor);
        for focal in [FocalKnown::Guessed, FocalKnown::Known] {
            let found = views.verified(&guess, focal);
            assert!(
                found.inliers.len() >= 295,
                "x {factor}, {focal:?}: {}",
                found.inliers.len()
            );
        }
    }
}

#[test]
fn planes_turns_and_lines_are_planar_and_keep_what_is_off_the_plane() {
    let turn = pose([0.05, 0.15, -0.02], [0.0; 3]);
    for (name, truth, layout, least) in [
        ("plane", sideways(), Layout::Plane, 200),
        ("almost plane", sideways(), Layout::AlmostPlane, 198),
        ("turn", turn, Layout::Deep, 200),
        ("infinity", sideways(), Layout::Infinity, 200),
        ("line", sideways(), Layout::Line, 180),
    ] {
        for sigma_px in [0.0, 0.5] {
            for focal in [FocalKnown::Known, FocalKnown::Guessed] {
                let views = views(truth, layout, 200, sigma_px, 8, &camera());
                let found = views.verified(&camera(), focal);
                let got = found.inliers.len();
                assert!(got >= least, "{name}, {sigma_px} px, {focal:?}: {got} {found:?}");
                let flat = name == "line" || found.kind == VerifiedKind::Planar;
                assert!(flat, "{name}, {sigma_px} px, {focal:?}: {:?}", found.kind);
                let finite = found
                    .fundamental
                    .is_none_or(|f| f.iter().all(|value| value.is_finite()));
                assert!(finite, "{name}");
            }
        }
    }
}

#[test]
fn outliers_off_a_plane_do_not_come_with_it() {
    let views = views(sideways(), Layout::AlmostPlane, 200, 0.5, 8, &camera()).with_outliers(60, 9);
    let found = views.verified(&camera(), FocalKnown::Known);
    let right = found.inliers.iter().filter(|m| m[0] >= 60).count();
    assert!(
        right >= 138 && found.inliers.len() - right <= 6,
        "{right} of {}",
        found.inliers.len()
    );
}

#[test]
fn what_does_not_move_is_stationary_or_left_out() {
    let mut views = views(sideways(), Layout::Deep, 200, 0.5, 10, &camera());
    let moving = views.a.clone();
    for i in 0..80 {
        views.b[i] = views.a[i] + Vector2::new(0.3, -0.2);
    }
    let found = views.verified(&camera(), FocalKnown::Known);
    let dirt = found.inliers.iter().filter(|m| m[0] < 80).count();
    assert!(
        dirt == 0 && found.inliers.len() >= 115,
        "{dirt} of {}",
        found.inliers.len()
    );
    assert_eq!(found.kind, VerifiedKind::General);
    views.b.clone_from(&moving);
    assert_eq!(
        views.verified(&camera(), FocalKnown::Known).kind,
        VerifiedKind::Stationary,
        "identical"
    );
}

#[test]
fn far_points_at_rest_come_back_when_they_fit() {
    // Forward motion past near points: far points and those around the epipole stay within 4 px.
    let mut near = views(
        pose([0.0; 3], [0.0, 0.0, -1.0]),
        Layout::Deep,
        150,
        0.3,
        11,
        &camera(),
    );
    let far = views(near.truth, Layout::Infinity, 50, 0.3, 12, &camera());
    near.a.extend(far.a);
    near.b.extend(far.b);
    let found = near.verified(&camera(), FocalKnown::Known);
    assert!(found.inliers.len() >= 198, "{}", found.inliers.len());
    assert_eq!(found.kind, VerifiedKind::General);
}

#[test]
fn two_features_at_one_pixel_are_one_witness() {
    let views = views(sideways(), Layout::Deep, 14, 0.2, 13, &camera());
    let matches: Vec<[u32; 2]> = (0..140).map(|i| [i % 14, i % 14]).collect();
    let camera = camera();
    let view = |pixels| ViewPoints {
        camera: &camera,
        pixels,
    };
    let found = super::super::verify(
        [&view(&views.a), &view(&views.b)],
        &matches,
        FocalKnown::Known,
        &OPTIONS,
        1,
    );
    assert_eq!(found.kind, VerifiedKind::None, "14 correspondences ten times");
}

#[test]
fn nothing_few_missing_and_broken_features_verify_nothing() {
    let camera = camera();
    let bad = [Vector2::new(f64::NAN, 1.0), Vector2::new(f64::INFINITY, 0.0)];
    let view = ViewPoints {
        camera: &camera,
        pixels: &bad,
    };
    for matches in [&[][..], &[[0, 1]], &[[0, 0]; 50], &[[7, 9]; 50]] {
        let found = super::super::verify([&view, &view], matches, FocalKnown::Known, &OPTIONS, 1);
        assert_eq!(found.kind, VerifiedKind::None, "{matches:?}");
        assert!(
            super::super::estimate_relative_pose([&view, &view], matches, FocalKnown::Known, 4.0, 1)
                .is_none(),
            "{matches:?}"
        );
    }
}

#[test]
fn a_pair_judged_twice_is_judged_alike() {
    let views = views(sideways(), Layout::Deep, 200, 1.0, 14, &camera()).with_outliers(60, 3);
    let [one, two] = [(); 2].map(|()| views.verified(&camera(), FocalKnown::Known));
    assert_eq!(one.inliers, two.inliers);
    assert_eq!(one.fundamental, two.fundamental);
}

#[test]
fn distortion_is_removed_before_anything_is_measured() {
    for k1 in [-0.3, 0.3] {
        let distorted = Camera { k1, ..camera() };
        let views = views(sideways(), Layout::Deep, 200, 0.2, 15, &distorted);
        for focal in [FocalKnown::Known, FocalKnown::Guessed] {
            let found = views.verified(&distorted, focal);
            assert!(
                found.inliers.len() >= 199,
                "k1 {k1}, {focal:?}: {}",
                found.inliers.len()
            );
        }
    }
}

#[test]
fn features_on_a_grid_lines_and_huge_numbers_never_panic_nor_give_nan() {
    let camera = camera();
    for seed in 0..120 {
        let mut rng = Rng::new(seed);
        let (count, cells) = (5 + rng.below(40) as usize, 1 + rng.below(6));
        let huge = [1.0, 1e150, 1e-150, 1e300][rng.below(4) as usize];
        let mut pixels = || {
            let mut number = || rng.below(cells) as f64 * 100.0 * huge;
            (0..count)
                .map(|_| Vector2::new(number(), number()))
                .collect::<Vec<_>>()
        };
        let (a, b) = (pixels(), pixels());
        let (a, b) = (
            ViewPoints {
                camera: &camera,
                pixels: &a,
            },
            ViewPoints {
                camera: &camera,
                pixels: &b,
            },
        );
        let matches: Vec<[u32; 2]> = (0..count as u32).map(|i| [i, i]).collect();
        let options = VerifyOptions {
            min_inliers: 5,
            ..OPTIONS
        };
        let found = super::super::verify([&a, &b], &matches, FocalKnown::Known, &options, seed);
        assert!(
            found
                .fundamental
                .is_none_or(|f| f.iter().all(|value| value.is_finite())),
            "seed {seed}"
        );
        let Some(relation) =
            super::super::estimate_relative_pose([&a, &b], &matches, FocalKnown::Known, 4.0, seed)
        else {
            continue;
        };
        assert!(relation.cam2_from_cam1.is_valid(), "seed {seed}: {relation:?}");
        assert!(relation.median_angle_rad.is_finite(), "seed {seed}");
    }
}
