use super::*;
use crate::dice::Dice;
use crate::estimators::scenes::{gauss, pose};
use crate::estimators::{log_so3, ray_angle_rad};
use nalgebra::Vector3;

const OPTIONS: VerifyOptions = VerifyOptions {
    max_error_px: 4.0,
    min_inliers: 15,
    max_trials: 2000,
    confidence: 0.999,
};

fn camera() -> Camera {
    Camera::pinhole(1000, 750, 900.0)
}

/// Features of two photos, the i-th of both the same point, and the motion between them.
struct Views {
    truth: Pose,
    a: Vec<Vector2<f64>>,
    b: Vec<Vector2<f64>>,
}

/// What the points of a made-up scene lie on.
#[derive(Debug, Clone, Copy)]
enum Layout {
    /// Depths 4 to 12.
    Deep,
    /// The plane z = 6 + .4 x - .3 y.
    Plane,
    /// The same, every tenth point up to 2 in front of it.
    AlmostPlane,
    /// One line.
    Line,
    /// A million times as far.
    Infinity,
}

fn depth(layout: Layout, index: usize, ray: &Vector3<f64>, dice: &mut Dice) -> f64 {
    let plane = 6.0 / (1.0 - 0.4 * ray.x + 0.3 * ray.y);
    match layout {
        Layout::Deep | Layout::Line => 4.0 + 8.0 * dice.unit(),
        Layout::Plane => plane,
        Layout::AlmostPlane if index.is_multiple_of(10) => plane - 0.5 - 1.5 * dice.unit(),
        Layout::AlmostPlane => plane,
        Layout::Infinity => 1e7 * (1.0 + dice.unit()),
    }
}

/// `count` points seen in both photos, with Gaussian noise on both pixels.
fn views(truth: Pose, layout: Layout, count: usize, sigma_px: f64, seed: u64, camera: &Camera) -> Views {
    let mut dice = Dice::new(seed);
    let (mut a, mut b) = (Vec::new(), Vec::new());
    for _ in 0..100_000 {
        let mut ray = Vector3::new((dice.unit() - 0.5) * 1.1, (dice.unit() - 0.5) * 0.8, 1.0);
        if let Layout::Line = layout {
            ray.y = 0.3 * ray.x + 0.1;
        }
        let point = ray * depth(layout, a.len(), &ray, &mut dice);
        if let (Some(p), Some(q)) = (camera.project(&point), camera.project(&truth.point(&point)))
            && q.x.abs() < 2000.0
            && a.len() < count
        {
            let mut noise = || Vector2::new(gauss(&mut dice), gauss(&mut dice)) * sigma_px;
            a.push(p + noise());
            b.push(q + noise());
        }
    }
    assert_eq!(a.len(), count);
    Views { truth, a, b }
}

impl Views {
    fn matches(&self) -> Vec<[u32; 2]> {
        (0..self.a.len() as u32).map(|i| [i, i]).collect()
    }

    /// Moves the first `wrong` features of photo 2 anywhere.
    fn with_outliers(mut self, wrong: usize, seed: u64) -> Self {
        let mut dice = Dice::new(seed);
        for q in self.b.iter_mut().take(wrong) {
            *q = Vector2::new(dice.unit() * 1000.0, dice.unit() * 750.0);
        }
        self
    }

    fn verify(&self, camera: &Camera, focal: FocalKnown) -> Verified {
        let (a, b) = (
            ViewPoints {
                camera,
                pixels: &self.a,
            },
            ViewPoints {
                camera,
                pixels: &self.b,
            },
        );
        verify(&a, &b, &self.matches(), focal, &OPTIONS, 7)
    }

    fn relate(&self, camera: &Camera) -> Option<Relation> {
        let (a, b) = (
            ViewPoints {
                camera,
                pixels: &self.a,
            },
            ViewPoints {
                camera,
                pixels: &self.b,
            },
        );
        relate(&a, &b, &self.matches(), OPTIONS.max_error_px, 7)
    }

    /// Errors of rotation and of the direction of translation, degrees.
    fn errors_deg(&self, relation: &Relation) -> [f64; 2] {
        let turn = relation.cam2_from_cam1.rotation.transpose() * self.truth.rotation;
        let (got, truth) = (relation.cam2_from_cam1.translation, self.truth.translation);
        [
            log_so3(&turn).norm(),
            ray_angle_rad(&got, &truth, &Vector3::zeros()),
        ]
        .map(f64::to_degrees)
    }
}

fn sideways() -> Pose {
    pose([0.02, -0.12, 0.03], [1.0, 0.1, -0.1])
}

#[test]
fn true_matches_survive_up_to_half_and_random_ones_are_refused() {
    for focal in [FocalKnown::Known, FocalKnown::Guessed] {
        for (wrong, least) in [(0, 290), (150, 145), (270, 0), (285, 0), (300, 0)] {
            let views = views(sideways(), Layout::Deep, 300, 0.5, 3, &camera()).with_outliers(wrong, 4);
            let found = views.verify(&camera(), focal);
            let right = found.inliers.iter().filter(|m| m[0] >= wrong as u32).count();
            assert!(right >= least, "{focal:?}, {wrong} of 300 wrong: {right} found");
            // Past what the trials reach (56 % wrong): all but a few of what is kept is right, or nothing is.
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
            let found = views.verify(&camera(), focal);
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
            let found = views.verify(&guess, focal);
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
                let found = views.verify(&camera(), focal);
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
    let found = views.verify(&camera(), FocalKnown::Known);
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
    let found = views.verify(&camera(), FocalKnown::Known);
    let dirt = found.inliers.iter().filter(|m| m[0] < 80).count();
    assert!(
        dirt == 0 && found.inliers.len() >= 115,
        "{dirt} of {}",
        found.inliers.len()
    );
    assert_eq!(found.kind, VerifiedKind::General);
    views.b.clone_from(&moving);
    assert_eq!(
        views.verify(&camera(), FocalKnown::Known).kind,
        VerifiedKind::Stationary,
        "identical"
    );
}

#[test]
fn far_points_at_rest_come_back_when_they_fit() {
    // Forward motion past near points: what is far or around the epipole stays within 4 px.
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
    let found = near.verify(&camera(), FocalKnown::Known);
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
    let found = verify(
        &view(&views.a),
        &view(&views.b),
        &matches,
        FocalKnown::Known,
        &OPTIONS,
        1,
    );
    assert_eq!(found.kind, VerifiedKind::None, "14 spots ten times");
    assert!(found.fundamental_inliers <= 14, "{}", found.fundamental_inliers);
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
        let found = verify(&view, &view, matches, FocalKnown::Known, &OPTIONS, 1);
        assert_eq!(found.kind, VerifiedKind::None, "{matches:?}");
        assert!(relate(&view, &view, matches, 4.0, 1).is_none(), "{matches:?}");
    }
}

#[test]
fn a_pair_judged_twice_is_judged_alike() {
    let views = views(sideways(), Layout::Deep, 200, 1.0, 14, &camera()).with_outliers(60, 3);
    let [one, two] = [(); 2].map(|()| views.verify(&camera(), FocalKnown::Known));
    assert_eq!(one.inliers, two.inliers);
    assert_eq!(one.fundamental, two.fundamental);
}

#[test]
fn distortion_is_removed_before_anything_is_measured() {
    for k1 in [-0.3, 0.3] {
        let bent = Camera { k1, ..camera() };
        let views = views(sideways(), Layout::Deep, 200, 0.2, 15, &bent);
        for focal in [FocalKnown::Known, FocalKnown::Guessed] {
            let found = views.verify(&bent, focal);
            assert!(
                found.inliers.len() >= 199,
                "k1 {k1}, {focal:?}: {}",
                found.inliers.len()
            );
        }
    }
}

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
            let found = views.relate(&camera()).unwrap();
            let [turn, direction] = views.errors_deg(&found);
            assert!(
                turn < limit_deg && direction < 3.0 * limit_deg,
                "{t:?} {sigma_px} px: {turn} {direction}"
            );
            assert_eq!(found.kind, RelationKind::General, "{t:?} {sigma_px} px");
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
                let found = views.relate(&camera()).unwrap();
                let [turn, direction] = views.errors_deg(&found);
                let limit_deg = 1e-6 + 2.0 * sigma_px;
                assert!(
                    turn < limit_deg && direction < 3.0 * limit_deg,
                    "{layout:?} {t:?} {sigma_px} px: {turn} {direction}"
                );
                assert_eq!(
                    found.kind,
                    RelationKind::Planar,
                    "{layout:?} {t:?} {sigma_px}: {}",
                    found.homography_share
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
                let found = views.relate(&camera()).unwrap();
                assert_eq!(
                    found.kind,
                    RelationKind::Rotation,
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
                .relate(&camera())
                .unwrap();
            let got = found.kind == RelationKind::Rotation;
            assert_eq!(
                got, rotation,
                "baseline {baseline:e}, {sigma_px} px, seed {seed}: {:?}",
                found.kind
            );
        }
    }
}

#[test]
fn relations_do_not_depend_on_the_unit_of_the_world() {
    // A world unit never enters: scaled scenes give the same pixels within rounding.
    let near = views(sideways(), Layout::Deep, 100, 0.0, 18, &camera());
    let angle = near.relate(&camera()).unwrap().median_angle_rad.to_degrees();
    assert!((5.0..12.0).contains(&angle), "{angle}");
}

/// Fundamental matrices of pairs of one camera that moves and turns freely.
fn pairs(
    count: u64,
    sigma_px: f64,
    camera: &Camera,
    layout: Layout,
    truth: impl Fn(&mut Dice) -> Pose,
) -> Vec<(Matrix3<f64>, usize)> {
    let guess = Camera {
        fx_px: 1200.0,
        fy_px: 1200.0,
        ..*camera
    };
    let pairs = (0..count).map(|seed| {
        let truth = truth(&mut Dice::new(seed));
        let found = views(truth, layout, 150, sigma_px, seed, camera).verify(&guess, FocalKnown::Guessed);
        (found.fundamental.unwrap(), found.inliers.len())
    });
    pairs.collect()
}

fn free_motion(dice: &mut Dice) -> Pose {
    let mut number = |size: f64| (dice.unit() - 0.5) * size;
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

/// [e]x H of a turn is essential at the true focal length for any e.
#[test]
fn turns_give_the_focal_length_or_none() {
    let turns = |dice: &mut Dice| pose([dice.unit() * 0.2, 0.1, 0.1], [0.0; 3]);
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
    let parallel = |dice: &mut Dice| pose([0.0, 0.0, dice.unit()], [1.0 + dice.unit(), dice.unit(), 0.0]);
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
