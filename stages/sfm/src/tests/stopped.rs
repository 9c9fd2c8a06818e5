//! A mapping that is stopped anywhere goes on to the same bits.

use marf_scene::Pose;
use nalgebra::Vector3;

use super::synthetic::{Synthetic, arc, camera, cloud};
use crate::mapper::{MapError, MapperInput, Model, extend, map};
use crate::supervisor::testing::Stopping;
use crate::view_graph::PosedCamera;

/// Two groups of photos of two objects, one camera for all: two models.
fn two_models() -> Synthetic {
    let far = Vector3::new(40.0, 0.0, 0.0);
    let beside = |pose: &Pose| {
        let eye = pose.centre() + far;
        Pose::looking_at(eye, far, Vector3::y())
    };
    let near = arc(7, 6.0, 1.2);
    let others: Vec<Pose> = arc(5, 6.0, 0.9).iter().map(beside).collect();
    let half = Vector3::new(2.0, 1.5, 2.0);
    Synthetic {
        start: super::guessed(700.0),
        ..Synthetic::new(
            [near, others].concat(),
            [cloud(200, Vector3::zeros(), half, 1), cloud(200, far, half, 2)].concat(),
        )
    }
}

type Mapped = Result<Vec<Model>, MapError>;

/// Runs again and again, stopped after as many questions each time.
fn in_pieces(supervisor: &Stopping, questions: u64, work: &dyn Fn() -> Mapped) -> (Vec<Model>, u32) {
    for stops in 0..2000 {
        supervisor.after(questions);
        match work() {
            Ok(models) => return (models, stops),
            Err(MapError::Stopped) => {}
            Err(error) => panic!("{error}"),
        }
    }
    panic!("no progress in pieces of {questions} questions");
}

fn check(scene: &Synthetic, work: &(dyn Fn(&MapperInput<'_>) -> Mapped + Sync), models: usize) {
    let expected = scene.with_input(|input| work(input).unwrap());
    assert_eq!(expected.len(), models);
    let supervisor = Stopping::default();
    scene.supervised(&supervisor, |input| {
        let run = || work(input);
        let (found, stops) = in_pieces(&supervisor, 25, &run);
        assert!(stops > 5, "{stops}");
        assert_eq!(found, expected, "in {stops} pieces");
    });
    for questions in [0, 3, 20, 50, 90, 130, 180, 240, 310, 400] {
        let supervisor = Stopping::default();
        scene.supervised(&supervisor, |input| {
            supervisor.after(questions);
            let stopped = work(input);
            supervisor.after(u64::MAX);
            let found = work(input).unwrap();
            assert_eq!(found, expected, "after {questions}: {}", stopped.is_err());
        });
    }
    let damages: [fn(&mut Vec<u8>); 3] = [
        |bytes| bytes.truncate(bytes.len() / 2),
        |bytes| bytes.truncate(bytes.len() - 1),
        |bytes| bytes.push(0),
    ];
    for damage in damages {
        let supervisor = Stopping::default();
        scene.supervised(&supervisor, |input| {
            supervisor.after(150);
            let _ = work(input);
            supervisor.damage(damage);
            supervisor.after(u64::MAX);
            assert_eq!(work(input).unwrap(), expected);
        });
    }
}

#[test]
fn the_models_are_the_same_wherever_the_mapping_was_stopped() {
    check(&two_models(), &|input| map(input), 2);
}

#[test]
fn an_extension_is_the_same_wherever_it_was_stopped() {
    let scene = Synthetic::new(
        arc(9, 6.0, 1.6),
        cloud(250, Vector3::zeros(), Vector3::new(2.0, 1.5, 2.0), 1),
    );
    let known: Vec<Option<PosedCamera>> = scene
        .poses
        .iter()
        .enumerate()
        .map(|(photo, pose)| {
            (photo < 4).then_some(PosedCamera {
                camera: camera(),
                cam_from_world: *pose,
            })
        })
        .collect();
    let work = |input: &MapperInput<'_>| Ok(extend(input, &known)?.into_iter().collect());
    check(&scene, &work, 1);
}

/// What another scene has left behind is of another scene.
#[test]
fn a_checkpoint_of_other_photos_is_not_taken() {
    let supervisor = Stopping::default();
    two_models().supervised(&supervisor, |input| {
        supervisor.after(150);
        assert!(map(input).is_err());
    });
    assert!(supervisor.parts().contains(&"mapping".to_owned()));
    let other = Synthetic {
        noise_px: 0.2,
        ..two_models()
    };
    let expected = other.solve();
    other.supervised(&supervisor, |input| {
        supervisor.after(u64::MAX);
        assert_eq!(map(input).unwrap(), expected);
    });
}
