use marf_cache::digest_of;
use marf_field::{Pixels, View};
use marf_scene::{Camera, Frame, Image, Photo, Scene, Srgb, picture_names};
use marf_schema::train::Holdout;
use marf_stage::{Ctx, StageError};
use rayon::prelude::*;

use crate::{TrainError, memory::Plan};

/// Every how many training photos one is held out for [`Holdout::Validation`].
pub(crate) const VALIDATION_EVERY: usize = 8;

/// A frame with the name of its pictures.
#[derive(Debug, Clone)]
pub(crate) struct Named<'a> {
    pub frame: &'a Frame,
    pub name: String,
}

/// Photos to train on and photos to measure on; none is in both.
#[derive(Debug)]
pub(crate) struct Split<'a> {
    pub training: Vec<Named<'a>>,
    pub held_out: Vec<Named<'a>>,
}

/// A photo at the size it is compared at.
#[derive(Debug, Clone)]
pub(crate) struct Reduced {
    pub camera: Camera,
    pub image: Image<Srgb>,
}

pub(crate) fn named(scene: &Scene) -> Vec<Named<'_>> {
    let names = picture_names(scene);
    let frames = scene.frames.iter().zip(names);
    frames.map(|(frame, name)| Named { frame, name }).collect()
}

/// Splits the frames of a scene.
///
/// # Errors
/// Either side empty.
pub(crate) fn split(scene: &Scene, holdout: Holdout) -> Result<Split<'_>, TrainError> {
    let (test, others): (Vec<_>, Vec<_>) = named(scene).into_iter().partition(|named| named.frame.held_out);
    let (held_out, training) = match holdout {
        Holdout::Test => (test, others),
        Holdout::Validation => {
            let numbered = others.into_iter().enumerate();
            let (held_out, training): (Vec<_>, Vec<_>) =
                numbered.partition(|(index, _)| index % VALIDATION_EVERY == 0);
            (second(held_out), second(training))
        }
    };
    let placed = scene.frames.len();
    if training.is_empty() {
        let held_out = held_out.len();
        return Err(TrainError::NoTraining { placed, held_out });
    }
    if held_out.is_empty() {
        return Err(TrainError::NoHeldOut { placed });
    }
    Ok(Split { training, held_out })
}

fn second<T>(pairs: Vec<(usize, T)>) -> Vec<T> {
    pairs.into_iter().map(|(_, value)| value).collect()
}

/// Returns how often each of `count` photos is drawn in `count` draws with replacement.
///
/// Draw i takes the photo ⌊count · h / 2⁶⁴⌋, h the first 8 bytes of the content hash of (seed, i); the bias is
/// below count / 2⁶⁴.
pub(crate) fn draws(count: usize, seed: u64) -> Vec<usize> {
    let mut times = vec![0; count];
    for index in 0..count as u64 {
        let digest = digest_of(&("photo", seed, index));
        let bytes = digest.as_bytes().iter().take(8).rev();
        let random = bytes.fold(0_u64, |value, byte| value << 8 | u64::from(*byte));
        times[((random as u128 * count as u128) >> 64) as usize] += 1;
    }
    times
}

/// Decodes and shrinks one photo.
pub(crate) fn reduced(ctx: &Ctx<'_>, frame: &Frame, scale: u32) -> Result<Reduced, StageError> {
    ctx.check()?;
    let bytes = ctx.get(&frame.image)?;
    let id = || frame.id.clone();
    let photo = Photo::decode_validated(&bytes).map_err(|cause| TrainError::Photo { id: id(), cause })?;
    let (image, camera) = (photo.image, &frame.camera);
    let (width, height) = (image.width, image.height);
    if (width, height) != (camera.width, camera.height) {
        let (camera_width, camera_height) = (camera.width, camera.height);
        return Err(TrainError::Size {
            id: id(),
            width,
            height,
            camera_width,
            camera_height,
        }
        .into());
    }
    if width < scale || height < scale {
        return Err(TrainError::Vanished {
            id: id(),
            width,
            height,
            scale,
        }
        .into());
    }
    Ok(Reduced {
        camera: camera.box_reduced(scale),
        image: image.box_reduced(scale),
    })
}

/// Decodes and shrinks photos and keeps of each what `keep` makes of it, in order; at most `at_once` photos are in
/// memory.
pub(crate) fn each_reduced<T: Send>(
    ctx: &Ctx<'_>,
    frames: &[Named<'_>],
    scale: u32,
    at_once: usize,
    keep: impl Fn(usize, Reduced) -> T + Sync,
) -> Result<Vec<T>, StageError> {
    let at_once = at_once.max(1);
    let mut kept = Vec::with_capacity(frames.len());
    for (group, frames) in frames.chunks(at_once).enumerate() {
        let photos = frames.par_iter().enumerate().with_max_len(1);
        let of_group: Result<Vec<T>, StageError> = photos
            .map(|(index, named)| {
                let photo = reduced(ctx, named.frame, scale)?;
                Ok(keep(group * at_once + index, photo))
            })
            .collect();
        kept.extend(of_group?);
    }
    Ok(kept)
}

/// Makes views of training photos, each as often as it was drawn, after a look at those held out: one that cannot
/// be read stops a training before it begins.
///
/// Of every run of `plan.run` pixels one is kept, drawn by `seed` and the photo's place among the training photos.
pub(crate) fn views(
    ctx: &Ctx<'_>,
    split: &Split<'_>,
    times: &[usize],
    scale: u32,
    plan: Plan,
    seed: u64,
) -> Result<Vec<View>, StageError> {
    each_reduced(ctx, &split.held_out, scale, plan.at_once, |_, _| ())?;
    let thinned = |index: usize, photo: Reduced| {
        let image = Pixels::thinned(photo.image, plan.run, seed, index as u64);
        (photo.camera, image)
    };
    let photos = each_reduced(ctx, &split.training, scale, plan.at_once, thinned)?;
    let mut views = Vec::with_capacity(times.iter().sum());
    for ((named, (camera, image)), times) in split.training.iter().zip(photos).zip(times) {
        let id = &named.frame.id;
        let copies = std::iter::repeat_n(image, *times);
        views.extend(copies.enumerate().map(|(copy, image)| View {
            id: if copy == 0 {
                id.clone()
            } else {
                format!("{id}#{}", copy + 1)
            },
            camera,
            cam_from_world: named.frame.cam_from_world,
            image,
        }));
    }
    Ok(views)
}

/// Returns the sparse points of a scene.
pub(crate) fn points(scene: &Scene) -> Vec<[f64; 3]> {
    scene.points.iter().map(|point| point.position).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_scene::Pose;

    fn scene(count: usize, is_held_out: impl Fn(usize) -> bool) -> Scene {
        let frame = |index: usize| Frame {
            id: format!("{index:02}"),
            file: format!("{index:02}.png"),
            image: marf_cache::Digest::of(b""),
            camera: Camera::pinhole(8, 8, 8.0),
            cam_from_world: Pose::identity(),
            held_out: is_held_out(index),
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
        assert!(text(&scene(1, |_| false), Holdout::Validation).starts_with("no photo to train on"));
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
