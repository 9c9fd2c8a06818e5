use std::collections::BTreeSet;

use marf_scene::{Frame, Point, PosedPhoto, Scene, folds, hold_out_places, picture_names};
use marf_schema::train::{Fold, Holdout};

use crate::{TrainError, random::random_u64};

/// About one in this many training photos is held out for [`Holdout::Validation`].
const VALIDATION_EVERY: u32 = 8;

/// A frame with the name of its pictures.
#[derive(Debug, Clone)]
pub(crate) struct NamedFrame<'a> {
    pub frame: &'a Frame,
    pub name: String,
}

/// Photos to train on and photos to measure on, without a photo in both.
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

/// Splits the frames of a scene into those to train on and those to measure on: a fold of all, if one is given.
///
/// # Errors
/// Either side empty.
pub(crate) fn split(scene: &Scene, holdout: Holdout, fold: Option<Fold>) -> Result<Split<'_>, TrainError> {
    let frames = named_frames(scene);
    let split = match (fold, holdout) {
        (Some(_), _) | (None, Holdout::Test) => parted(frames, held_out(scene, fold)),
        (None, Holdout::Validation) => {
            let others = frames.into_iter().filter(|named| !named.frame.held_out);
            hold_out_by_place(others.collect(), &scene.points)
        }
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

/// Holds out whole places, about one frame in eight, as `calibrate` does. `points` are the sparse points of the scene.
pub(crate) fn hold_out_by_place<'a>(frames: Vec<NamedFrame<'a>>, points: &[Point]) -> Split<'a> {
    let photos: Vec<PosedPhoto<'_>> = frames.iter().map(|named| named.frame.into()).collect();
    let is_held_out = hold_out_places(&photos, points, VALIDATION_EVERY);
    parted(frames, is_held_out)
}

/// Returns for each frame of a scene whether a fold holds it out, or `calibrate` does.
pub(crate) fn held_out(scene: &Scene, fold: Option<Fold>) -> Vec<bool> {
    match fold {
        Some(fold) => fold_of_each(scene, fold.count)
            .into_iter()
            .map(|own| own == fold.index)
            .collect(),
        None => scene.frames.iter().map(|frame| frame.held_out).collect(),
    }
}

/// Returns the fold in which each frame of a scene is held out.
pub(crate) fn fold_of_each(scene: &Scene, count: u32) -> Vec<u32> {
    let photos: Vec<PosedPhoto<'_>> = scene.frames.iter().map(PosedPhoto::from).collect();
    folds(&photos, &scene.points, count)
}

fn parted<'a>(frames: Vec<NamedFrame<'a>>, is_held_out: impl IntoIterator<Item = bool>) -> Split<'a> {
    let mut split = Split {
        training: Vec::new(),
        held_out: Vec::new(),
    };
    for (frame, is_held_out) in frames.into_iter().zip(is_held_out) {
        if is_held_out {
            split.held_out.push(frame);
        } else {
            split.training.push(frame);
        }
    }
    split
}

/// Returns `wanted` indices below `count`, or all, evenly spaced.
pub(crate) fn spread(count: usize, wanted: usize) -> impl ExactSizeIterator<Item = usize> {
    let wanted = wanted.min(count);
    (0..wanted).map(move |index| (2 * index + 1) * count / (2 * wanted))
}

/// Returns the indices below `count` in an order whose beginning, however long, is spread over all: the bits of 0, 1, 2, ... read
/// backwards (van der Corput's sequence).
pub(crate) fn spread_order(count: usize) -> Vec<usize> {
    let bits = count.next_power_of_two().trailing_zeros();
    let reversed = |index: usize| match bits {
        0 => 0,
        bits => index.reverse_bits() >> (usize::BITS - bits),
    };
    let indices = (0..1 << bits).map(reversed);
    indices.filter(|index| *index < count).collect()
}

/// Returns `wanted` of the frames, or all, evenly spaced.
pub(crate) fn some_of(frames: Vec<NamedFrame<'_>>, wanted: usize) -> Vec<NamedFrame<'_>> {
    let kept: BTreeSet<usize> = spread(frames.len(), wanted).collect();
    let frames = frames.into_iter().enumerate();
    frames
        .filter(|(index, _)| kept.contains(index))
        .map(|(_, frame)| frame)
        .collect()
}

/// Returns how often each of `count` photos is drawn in `count` draws with replacement.
///
/// Draw i takes the photo ⌊count · h / 2⁶⁴⌋, h the first 8 bytes of the content hash of (seed, i). The bias is below count / 2⁶⁴.
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
            image: marf_cache::Digest::from_content(b""),
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
    fn the_beginning_of_the_order_is_spread_over_all_and_each_comes_once() {
        assert_eq!(spread_order(8), [0, 4, 2, 6, 1, 5, 3, 7]);
        assert_eq!(spread_order(5), [0, 4, 2, 1, 3]);
        assert_eq!([spread_order(0), spread_order(1)], [vec![], vec![0]]);
        let mut all = spread_order(1000);
        let largest_gap = |mut first: Vec<usize>| {
            first.sort_unstable();
            first.windows(2).map(|pair| pair[1] - pair[0]).max()
        };
        assert_eq!(largest_gap(all[..32].to_vec()), Some(32));
        all.sort_unstable();
        assert_eq!(all, (0..1000).collect::<Vec<_>>());
    }

    #[test]
    fn validation_never_touches_the_test_photos() {
        let scene = scene(20, |index| index % 5 == 0);
        let test = split(&scene, Holdout::Test, None).unwrap();
        assert_eq!((test.training.len(), test.held_out.len()), (16, 4));
        let validation = split(&scene, Holdout::Validation, None).unwrap();
        // All 16 others are in one place, which is split into groups of at most the number to hold out.
        assert_eq!((validation.training.len(), validation.held_out.len()), (14, 2));
        let all = validation.training.iter().chain(&validation.held_out);
        assert!(all.into_iter().all(|named| !named.frame.held_out));
    }

    #[test]
    fn folds_hold_out_every_photo_once_those_of_the_final_metric_too() {
        let scene = scene(20, |index| index % 5 == 0);
        let mut held_out: Vec<String> = (0..4)
            .flat_map(|index| {
                let fold = Fold {
                    index,
                    count: 4,
                    share: 1.0,
                };
                let split = split(&scene, Holdout::Test, Some(fold)).unwrap();
                // All are in one place, which is split into groups of four. One fold has two of these groups.
                assert_eq!(split.training.len() + split.held_out.len(), 20);
                assert!([4, 8].contains(&split.held_out.len()), "{}", split.held_out.len());
                split.held_out.into_iter().map(|named| named.name)
            })
            .collect();
        held_out.sort();
        held_out.dedup();
        assert_eq!(held_out.len(), 20);
    }

    #[test]
    fn an_empty_side_is_an_error_that_says_how_many_there_are() {
        let text = |scene: &Scene, holdout| {
            let error = split(scene, holdout, None).unwrap_err();
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
