use marf_scene::{Frame, Point, PosedPhoto, Scene, hold_out_places, picture_names};
use marf_schema::train::Holdout;

use crate::{TrainError, random::random_u64};

/// About one of so many training photos is held out for [`Holdout::Validation`].
const VALIDATION_EVERY: u32 = 8;

/// A frame with the name of its pictures.
#[derive(Debug, Clone)]
pub(crate) struct NamedFrame<'a> {
    pub frame: &'a Frame,
    pub name: String,
}

/// Photos to train on and photos to measure on; none is both.
#[derive(Debug)]
pub(crate) struct Split<'a> {
    pub training: Vec<NamedFrame<'a>>,
    pub held_out: Vec<NamedFrame<'a>>,
}

/// Returns the frames of a scene with the names of their pictures.
pub(crate) fn named_frames(scene: &Scene) -> Vec<NamedFrame<'_>> {
    let names = picture_names(scene);
    let frames = scene.frames.iter().zip(names);
    frames.map(|(frame, name)| NamedFrame { frame, name }).collect()
}

/// Splits the frames of a scene into those to train on and those to measure on.
///
/// # Errors
/// Either side empty.
pub(crate) fn split(scene: &Scene, holdout: Holdout) -> Result<Split<'_>, TrainError> {
    let (test, others): (Vec<_>, Vec<_>) = named_frames(scene)
        .into_iter()
        .partition(|named| named.frame.held_out);
    let split = match holdout {
        Holdout::Test => Split {
            training: others,
            held_out: test,
        },
        Holdout::Validation => hold_out_by_place(others, &scene.points),
    };
    let placed = scene.frames.len();
    if split.training.is_empty() {
        let held_out = split.held_out.len();
        return Err(TrainError::NoTraining { placed, held_out });
    }
    if split.held_out.is_empty() {
        return Err(TrainError::NoHeldOut { placed });
    }
    Ok(split)
}

/// Holds out whole places, about one frame in eight, as `calibrate` does; `points` are the sparse points of the scene.
pub(crate) fn hold_out_by_place<'a>(frames: Vec<NamedFrame<'a>>, points: &[Point]) -> Split<'a> {
    let photos: Vec<PosedPhoto<'_>> = frames.iter().map(|named| named.frame.into()).collect();
    let is_held_out = hold_out_places(&photos, points, VALIDATION_EVERY);
    let pairs = frames.into_iter().zip(is_held_out);
    let (held_out, training): (Vec<_>, Vec<_>) = pairs.partition(|(_, is_held_out)| *is_held_out);
    let frames = |pairs: Vec<(NamedFrame<'a>, bool)>| pairs.into_iter().map(|(named, _)| named).collect();
    Split {
        training: frames(training),
        held_out: frames(held_out),
    }
}

/// Returns how often each of `count` photos is drawn in `count` draws with replacement.
///
/// Draw i takes the photo ⌊count · h / 2⁶⁴⌋, h the first 8 bytes of the content hash of (seed, i); the bias is
/// below count / 2⁶⁴.
pub(crate) fn draws(count: usize, seed: u64) -> Vec<usize> {
    let mut times = vec![0; count];
    for index in 0..count as u64 {
        let random = random_u64(&("photo", seed, index));
        times[((random as u128 * count as u128) >> 64) as usize] += 1;
    }
    times
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_scene::{Camera, Pose};

    fn scene(count: usize, is_held_out: impl Fn(usize) -> bool) -> Scene {
        let frame = |index: usize| Frame {
            id: format!("{index:02}"),
            file: format!("{index:02}.png"),
            image: marf_cache::Digest::of(b""),
            camera: Camera::pinhole(8, 8, 8.0),
            cam_from_world: Pose::identity(),
            held_out: is_held_out(index),
            mask: None,
            error_px: None,
        };
        Scene {
            frames: (0..count).map(frame).collect(),
            ..Scene::default()
        }
    }

    #[test]
    fn validation_never_touches_the_test_photos() {
        let scene = scene(20, |index| index % 5 == 0);
        let test = split(&scene, Holdout::Test).unwrap();
        assert_eq!((test.training.len(), test.held_out.len()), (16, 4));
        let validation = split(&scene, Holdout::Validation).unwrap();
        // All 16 others stand in one place, which is split in groups of as many as are to be held out.
        assert_eq!((validation.training.len(), validation.held_out.len()), (14, 2));
        let all = validation.training.iter().chain(&validation.held_out);
        assert!(all.into_iter().all(|named| !named.frame.held_out));
    }

    #[test]
    fn an_empty_side_is_an_error_that_says_how_many_there_are() {
        let text = |scene: &Scene, holdout| {
            let error = split(scene, holdout).unwrap_err();
            assert!(error.hint().is_some());
            error.to_string()
        };
        assert!(text(&scene(0, |_| false), Holdout::Test).starts_with("no photo to train on: 0 photos"));
        assert!(text(&scene(3, |_| true), Holdout::Test).contains("3 of them are held out"));
        assert!(text(&scene(3, |_| false), Holdout::Test).starts_with("no photo is held out of 3"));
        assert!(text(&scene(1, |_| false), Holdout::Validation).starts_with("no photo is held out of 1"));
    }

    #[test]
    fn a_bootstrap_sample_is_as_large_as_the_set_and_leaves_some_out() {
        for seed in [0, 1, u64::MAX] {
            let times = draws(1000, seed);
            assert_eq!(times.iter().sum::<usize>(), 1000);
            // 1 - 1/e = 63.2 % are expected, with a standard deviation of 1 %.
            let distinct = times.iter().filter(|times| **times > 0).count();
            assert!((590..=670).contains(&distinct), "seed {seed}: {distinct}");
        }
        assert_eq!(draws(50, 3), draws(50, 3));
        assert_ne!(draws(50, 3), draws(50, 3 + (1 << 40)));
        assert_eq!(draws(1, 9), [1]);
    }
}
