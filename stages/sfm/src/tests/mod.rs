//! Mapping of synthetic photos with known ground truth, at the extremes: a correct result or none.

mod intruders;
pub(crate) mod polls;
mod stopped;
mod synthetic;

use marf_scene::{Camera, Pose};
use nalgebra::{Matrix3, Vector3};

use crate::align::{PosePair, Similarity, Tolerance, align};
use crate::mapper::{MapError, Model, map, merge_last, triangulate};
use crate::view_graph::PosedCamera;
use synthetic::{Errors, Synthetic, arc, camera, cloud, guessed, known};

/// 0.3 px of noise at 800 px of focal length and some 150 points leave about this much.
const POSITION: f64 = 0.005;
const ANGLE_RAD: f64 = 0.003;

fn ball(count: usize) -> Vec<Vector3<f64>> {
    cloud(count, Vector3::zeros(), Vector3::new(2.0, 1.5, 2.0), 1)
}

#[track_caller]
fn right(name: &str, scene: &Synthetic) -> Errors {
    let errors = scene.errors().unwrap_or_else(|| panic!("{name}: no model"));
    assert_eq!(errors.photos, scene.poses.len(), "{name}: {errors:?}");
    assert!(
        errors.position < POSITION && errors.angle_rad < ANGLE_RAD,
        "{name}: {errors:?}"
    );
    errors
}

#[test]
fn an_orbit_is_solved_with_none_to_many_outliers() {
    for outliers in [0.0, 0.1, 0.5] {
        let scene = Synthetic {
            outliers,
            ..Synthetic::new(arc(10, 6.0, 2.0), ball(300))
        };
        right(&format!("outliers {outliers}"), &scene);
    }
}

#[test]
fn all_outliers_give_no_model() {
    let scene = Synthetic {
        outliers: 1.0,
        ..Synthetic::new(arc(6, 6.0, 1.0), ball(200))
    };
    assert!(scene.solve().is_empty());
}

#[test]
fn two_photos_are_enough() {
    right("two", &Synthetic::new(arc(2, 6.0, 0.4), ball(300)));
}

#[test]
fn too_few_photos_to_release_lens_terms_have_a_pinhole() {
    let models = Synthetic::new(arc(2, 6.0, 0.4), ball(300)).solve();
    assert_eq!(models[0].lens, crate::bundle::LensModel::Pinhole);
}

#[test]
fn one_photo_and_none_give_no_model() {
    for count in [0, 1] {
        assert!(
            Synthetic::new(arc(count, 6.0, 0.4), ball(100)).solve().is_empty(),
            "{count}"
        );
    }
}

#[test]
fn a_plane_is_solved() {
    let plane = cloud(300, Vector3::zeros(), Vector3::new(3.0, 2.5, 0.0), 2);
    right("plane", &Synthetic::new(arc(8, 6.0, 1.2), plane.clone()));
    let mut nearly = plane;
    nearly.push(Vector3::new(0.3, 0.2, -1.0));
    right("plane and one point", &Synthetic::new(arc(8, 6.0, 1.2), nearly));
}

#[test]
fn forward_motion_is_solved() {
    let poses = (0..8)
        .map(|index| forward(-10.0 + 0.8 * f64::from(index)))
        .collect();
    let points = cloud(400, Vector3::zeros(), Vector3::new(3.0, 2.5, 2.0), 3);
    right("forward", &Synthetic::new(poses, points));
}

fn forward(z: f64) -> Pose {
    Pose {
        rotation: Matrix3::identity(),
        translation: Vector3::new(0.0, 0.0, -z),
    }
}

#[test]
fn collinear_cameras_are_solved() {
    let pose = |index: i32| {
        let eye = Vector3::new(0.5 * f64::from(index) - 2.0, 0.0, -6.0);
        Pose::looking_at(eye, Vector3::new(0.3 * eye.x, 0.0, 0.0), Vector3::y())
    };
    right(
        "collinear",
        &Synthetic::new((0..9).map(pose).collect(), ball(300)),
    );
}

#[test]
fn a_pure_rotation_is_refused() {
    for noise_px in [0.0, 0.3, 1.0] {
        let pose = |index: i32| {
            let angle = 0.1 * f64::from(index);
            Pose::looking_at(
                Vector3::zeros(),
                Vector3::new(libm::sin(angle), 0.05, libm::cos(angle)),
                Vector3::y(),
            )
        };
        let far = cloud(
            1500,
            Vector3::new(4.0, 0.0, 12.0),
            Vector3::new(16.0, 6.0, 8.0),
            4,
        );
        let scene = Synthetic {
            noise_px,
            ..Synthetic::new((0..8).map(pose).collect(), far)
        };
        let models = scene.solve();
        assert!(models.is_empty(), "noise {noise_px}: {} models", models.len());
    }
}

#[test]
fn a_baseline_that_is_nothing_is_refused() {
    for baseline in [0.0, 1e-9, 1e-5] {
        let pose = |index: i32| {
            let eye = Vector3::new(baseline * f64::from(index), 0.0, -6.0);
            Pose::looking_at(eye, Vector3::new(0.05 * f64::from(index), 0.0, 0.0), Vector3::y())
        };
        let models = Synthetic::new((0..4).map(pose).collect(), ball(300)).solve();
        assert!(models.is_empty(), "{baseline}: {} models", models.len());
    }
}

#[test]
fn duplicate_photos_do_no_harm() {
    let mut poses = arc(8, 6.0, 1.6);
    poses.push(poses[3]);
    poses.push(poses[3]);
    right("duplicates", &Synthetic::new(poses, ball(300)));
}

#[test]
fn a_focal_length_wrong_by_two_is_found() {
    for factor in [0.5, 2.0] {
        let scene = Synthetic {
            start: guessed(800.0 * factor),
            ..Synthetic::new(arc(12, 6.0, 2.4), ball(400))
        };
        let errors = right(&format!("factor {factor}"), &scene);
        assert!(errors.focal < 0.01, "{factor}: {errors:?}");
    }
}

#[test]
fn photos_with_a_camera_of_their_own_find_its_focal_length() {
    for apart in [vec![3], vec![1, 4, 5, 9], (1..12).collect()] {
        let scene = Synthetic {
            start: guessed(1150.0),
            apart: apart.clone(),
            ..Synthetic::new(arc(12, 6.0, 2.4), ball(400))
        };
        right(&format!("apart {apart:?}"), &scene);
    }
}

#[test]
fn a_principal_point_outside_the_photo_is_no_matter() {
    let tile = Camera {
        cx_px: -500.0,
        cy_px: 1300.0,
        ..camera()
    };
    let turned = |pose: Pose| {
        // Looking away from the scene, whose image then falls in the tile.
        let ray = tile
            .unproject(&nalgebra::Vector2::new(480.0, 360.0))
            .unwrap()
            .normalize();
        let away = Pose::looking_at(Vector3::zeros(), ray, Vector3::y());
        Pose {
            translation: Vector3::zeros(),
            ..away.inverse()
        } * pose
    };
    let poses = arc(8, 8.0, 1.2).into_iter().map(turned).collect();
    let scene = Synthetic {
        camera: tile,
        start: known(tile),
        ..Synthetic::new(poses, ball(400))
    };
    right("tile", &scene);
}

#[test]
fn a_descent_through_38_times_the_scale_is_solved() {
    // From 38 to 1 above gentle ground, each step a fifth lower, with a little sideways drift.
    let poses: Vec<Pose> = (0..20)
        .map(|step| {
            let height = 38.0 / libm::pow(38.0, f64::from(step) / 19.0);
            let eye = Vector3::new(0.02 * height, 0.03 * f64::from(step), -height);
            Pose::looking_at(eye, Vector3::new(0.0, 0.0, 0.0), Vector3::y())
        })
        .collect();
    let mut points = Vec::new();
    for (ring, half) in [0.5, 1.0, 2.0, 4.0, 8.0, 16.0].into_iter().enumerate() {
        points.extend(cloud(
            250,
            Vector3::zeros(),
            Vector3::new(half, 0.8 * half, 0.08 * half),
            20 + ring as u64,
        ));
    }
    right("descent", &Synthetic::new(poses, points));
}

/// A disc hides 0.6 of a photo in the middle of a descent.
#[test]
fn the_unit_and_the_place_of_the_world_are_no_matter() {
    for (unit, shift) in [(1e-12, 0.0), (1e12, 0.0), (1.0, 1e4), (1.0, 1e6)] {
        let shift = Vector3::new(shift, -shift, shift);
        let poses = arc(8, 6.0, 1.6).into_iter().map(|pose| Pose {
            rotation: pose.rotation,
            translation: -(pose.rotation * (pose.centre() * unit + shift)),
        });
        let points = ball(300).into_iter().map(|point| point * unit + shift).collect();
        right(
            &format!("unit {unit}, shift {}", shift.x),
            &Synthetic::new(poses.collect(), points),
        );
    }
}

/// Half of the points are the other half a little to the right, and a third of the matches take one for the other.
/// These are wrong matches that agree with each other.
#[test]
fn repeated_texture_is_solved() {
    let mut points = ball(200);
    points.extend(ball(200).iter().map(|point| point + Vector3::new(0.4, 0.0, 0.0)));
    let scene = Synthetic {
        confused: 0.33,
        ..Synthetic::new(arc(10, 6.0, 1.6), points)
    };
    right("a third confused", &scene);
}

#[test]
fn a_photo_of_another_place_stays_out() {
    let mut poses = arc(8, 6.0, 1.6);
    let elsewhere = Vector3::new(500.0, 0.0, 0.0);
    poses.push(Pose::looking_at(
        elsewhere - Vector3::new(0.0, 0.0, 6.0),
        elsewhere,
        Vector3::y(),
    ));
    let mut points = ball(300);
    points.extend(cloud(300, elsewhere, Vector3::new(2.0, 1.5, 2.0), 9));
    let models = Synthetic::new(poses, points).solve();
    assert_eq!(models.len(), 1);
    assert_eq!(models[0].photos().collect::<Vec<_>>(), (0..8).collect::<Vec<_>>());
}

#[test]
fn two_places_are_two_models() {
    let elsewhere = Vector3::new(500.0, 0.0, 0.0);
    let mut poses = arc(8, 6.0, 1.6);
    poses.extend(arc(6, 6.0, 1.2).into_iter().map(|pose| Pose {
        rotation: pose.rotation,
        translation: -(pose.rotation * (pose.centre() + elsewhere)),
    }));
    let mut points = ball(300);
    points.extend(cloud(300, elsewhere, Vector3::new(2.0, 1.5, 2.0), 9));
    let models = Synthetic::new(poses, points).solve();
    let sizes: Vec<usize> = models.iter().map(|model| model.photos().count()).collect();
    assert_eq!(sizes, [8, 6]);
}

#[test]
fn noise_is_followed_and_more_of_it_is_survived() {
    for noise_px in [0.0, 0.1, 1.0] {
        let scene = Synthetic {
            noise_px,
            ..Synthetic::new(arc(10, 6.0, 2.0), ball(400))
        };
        let errors = scene.errors().unwrap();
        assert_eq!(errors.photos, 10, "{noise_px}");
        assert!(
            errors.position < 1e-5 + 0.008 * noise_px,
            "{noise_px}: {errors:?}"
        );
    }
}

/// Two halves of an orbit, in frames of their own, with four photos in both.
#[test]
fn models_that_share_photos_are_merged_and_others_stay_apart() {
    let scene = Synthetic::new(arc(12, 6.0, 2.0), ball(400));
    scene.with_input(|input| {
        let whole = map(input).unwrap().remove(0);
        let part = |photos: std::ops::Range<usize>| {
            let mut part = whole.clone();
            for photo in (0..12).filter(|photo| !photos.contains(photo)) {
                part.remove(input, photo);
            }
            part.anchor = photos.start;
            part
        };
        let elsewhere = |mut model: Model| {
            let similarity = Similarity {
                scale: 7.0,
                rotation: Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0),
                translation: Vector3::new(100.0, -50.0, 3.0),
            };
            model.transform(&similarity);
            model
        };
        let merged = merge_last(input, vec![part(0..8), elsewhere(part(4..12))]).unwrap();
        assert_eq!(merged.len(), 1);
        assert_eq!(merged[0].photos().count(), 12);
        let pair = |photo: usize| PosePair {
            cam_from_source: merged[0].poses[photo].unwrap(),
            cam_from_target: scene.poses[photo],
        };
        let pairs: Vec<PosePair> = (0..12).map(pair).collect();
        let close = Tolerance {
            distance: 0.02,
            angle_rad: ANGLE_RAD,
        };
        assert_eq!(align(&pairs, &close).unwrap().inliers.len(), 12);
        let apart = merge_last(input, vec![part(0..6), elsewhere(part(6..12))]).unwrap();
        assert_eq!(apart.len(), 2);
    });
}

/// Every tenth match is wrong. Noise of 0.3 px at a focal length of 800 px and a distance of 4 is 1.5 mm across.
#[test]
fn photos_of_known_cameras_give_points_and_stay_where_they_are() {
    let scene = Synthetic::new(arc(8, 4.0, 1.2), ball(300));
    let known = scene.poses.iter().map(|pose| {
        Some(PosedCamera {
            camera: scene.camera,
            cam_from_world: *pose,
        })
    });
    let mut known: Vec<Option<PosedCamera>> = known.collect();
    known[7] = None;
    let model = scene.with_input(|input| triangulate(input, &known).unwrap().unwrap());
    let poses: Vec<Option<Pose>> = known.iter().map(|known| Some((*known)?.cam_from_world)).collect();
    assert_eq!(model.poses, poses);
    let distance = |point: &Vector3<f64>| {
        let all = scene.points.iter().map(|truth| (truth - point).norm());
        all.fold(f64::INFINITY, f64::min)
    };
    let mut distances: Vec<f64> = model.points.iter().flatten().map(distance).collect();
    distances.sort_by(f64::total_cmp);
    assert!((250..=340).contains(&distances.len()), "{}", distances.len());
    assert!(distances[distances.len() * 9 / 10] < 0.01, "{distances:?}");
    let nothing = vec![None; 8];
    assert!(
        scene
            .with_input(|input| triangulate(input, &nothing).unwrap())
            .is_none()
    );
    let stopped = scene.stoppable(&|| true, |input| triangulate(input, &known));
    assert!(matches!(stopped, Err(MapError::Stopped)), "{stopped:?}");
}
