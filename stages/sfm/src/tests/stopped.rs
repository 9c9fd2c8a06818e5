//! A mapping stops wherever it polls, without a result.

use marf_scene::Pose;
use nalgebra::Vector3;

use super::polls::Polls;
use super::synthetic::{Synthetic, arc, camera, cloud};
use crate::mapper::{MapError, MapperInput, Model, extend, map};
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

fn check(scene: &Synthetic, work: &dyn Fn(&MapperInput<'_>) -> Mapped, models: usize) {
    let polls = Polls::new(u64::MAX);
    let found = scene.stoppable(&|| polls.stop(), |input| work(input).unwrap());
    assert_eq!(found.len(), models);
    let all = polls.count();
    assert!(all > 30, "{all} polls");
    for after in [0, 1, 3, all / 10, all / 4, all / 2, all - 1] {
        let polls = Polls::new(after);
        let stopped = scene.stoppable(&|| polls.stop(), work);
        assert!(matches!(stopped, Err(MapError::Stopped)), "after {after}");
    }
    let polls = Polls::new(all);
    let again = scene.stoppable(&|| polls.stop(), |input| work(input).unwrap());
    assert_eq!(again, found, "not stopped");
}

#[test]
fn a_mapping_stops_wherever_it_polls() {
    check(&two_models(), &|input| map(input), 2);
}

#[test]
fn an_extension_stops_wherever_it_polls() {
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
