//! Photos that something hides, and parts of the camera's own pictures that are fixed to it.

use super::*;
use crate::mapper::remove_intruders;

#[test]
fn a_photo_that_a_disc_hides_is_removed_and_no_other() {
    let poses: Vec<Pose> = (0..12)
        .map(|step| {
            let height = 8.0 / libm::pow(8.0, f64::from(step) / 11.0);
            let eye = Vector3::new(0.2 * height, 0.03 * f64::from(step), -height);
            Pose::looking_at(eye, Vector3::zeros(), Vector3::y())
        })
        .collect();
    let ground = [0.6, 1.2, 2.4, 4.8].into_iter().zip(20..);
    let rings = ground
        .flat_map(|(half, seed)| cloud(700, Vector3::zeros(), Vector3::new(half, half, 0.05 * half), seed));
    let points: Vec<_> = rings.collect();
    let radius = (0.6 * 960.0 * 720.0 / std::f64::consts::PI).sqrt();
    for hidden in [vec![], vec![(5, radius)], vec![(0, radius), (7, radius)]] {
        let scene = Synthetic {
            hidden,
            ..Synthetic::new(poses.clone(), points.clone())
        };
        scene.with_input(|input| {
            let mut models = map(input).unwrap();
            let placed: Vec<usize> = models[0].photos().collect();
            let found = remove_intruders(input, &mut models[0]).hidden;
            let removed: Vec<usize> = found.iter().map(|one| one.photo).collect();
            let hidden = scene.hidden.iter().map(|(photo, _)| *photo);
            // The first photo shows only its rim, which the next ones do not reach: it may not be placed at all.
            let expected: Vec<usize> = hidden.filter(|photo| placed.contains(photo)).collect();
            assert_eq!(removed, expected, "{found:?}");
            let is_open = |photo: &usize| *photo > 0 || scene.hidden.iter().all(|(hidden, _)| *hidden != 0);
            assert!(
                (0..12).filter(is_open).all(|photo| placed.contains(&photo)),
                "{placed:?}"
            );
            assert!(
                found
                    .iter()
                    .all(|one| 5 * one.hidden_cells > 2 * one.compared_cells && one.shown == 0),
                "{found:?}"
            );
            assert_eq!(models[0].photos().count(), placed.len() - removed.len());
            let anchor = models[0].anchor;
            assert!(models[0].poses[anchor].is_some());
            let unseen = |photo: &usize| models[0].active_in(input, *photo).next().is_none();
            assert!(removed.iter().all(unseen), "a removed photo holds points");
        });
    }
}

/// The rover's own parts are in the same place of every photo. They are found, and are no reason to lose any photo.
#[test]
fn a_disc_in_every_photo_is_a_fixed_part_and_removes_none() {
    // Each camera looks straight ahead, a disc's half further to the right than the one before.
    let poses: Vec<Pose> = (0..12)
        .map(|step| {
            let eye = Vector3::new(0.45 * (f64::from(step) - 5.5), 0.0, -6.0);
            Pose::looking_at(eye, eye + Vector3::z(), Vector3::y())
        })
        .collect();
    let points = cloud(3000, Vector3::zeros(), Vector3::new(5.0, 2.0, 0.5), 4);
    for radius in [0.0, 130.0] {
        let mut scene = Synthetic::new(poses.clone(), points.clone());
        scene.hidden = (0..12).map(|photo| (photo, radius)).collect();
        scene.with_input(|input| {
            let mut models = map(input).unwrap();
            let found = remove_intruders(input, &mut models[0]);
            assert_eq!(found.hidden, [], "{radius}");
            assert_eq!(models[0].photos().count(), 12, "{radius}");
            if radius == 0.0 {
                assert_eq!(found.fixed, [], "nothing hides the scene");
                return;
            }
            let [part] = &found.fixed[..] else {
                panic!("{:?}", found.fixed)
            };
            assert_eq!((part.camera, part.shown), (0, 0));
            assert!(part.covers(0.45, 0.45) && part.covers(0.55, 0.55), "{part:?}");
            assert!(!part.covers(0.5, 0.15) && !part.covers(0.15, 0.5), "{part:?}");
        });
    }
}
