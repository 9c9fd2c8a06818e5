use marf_field::{Config, Pixels, decoding_bytes, judging_bytes, training_bytes};
use marf_schema::train::Memory;

use crate::{
    TrainError,
    split::{NamedFrame, Split},
};

/// Memory of the program itself: stacks and scratch of its threads, and what the allocator keeps. 60 MB were measured
/// on 2 threads.
const PROGRAM_BYTES: u64 = 100_000_000;

/// How photos are kept so that a training stays within its memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct MemoryPlan {
    /// Pixels of a run, one of which is kept.
    pub run: u32,
    /// Photos that may be decoded at once. No result depends on it.
    pub at_once: usize,
}

/// Returns the shortest run of pixels with which a training fits its memory, and how many photos may be decoded at once.
///
/// `times`: how often each training photo is used. The factors shrink the photos trained on and those that judge. The estimate is the
/// program plus the largest of three states: the photos kept with the training ([`training_bytes`]), the photos kept with one being
/// decoded, and one view being compared.
///
/// # Errors
/// [`TrainError::Memory`] if not even one pixel in 255 fits, before anything is decoded.
pub(crate) fn plan_memory(
    memory: Memory,
    split: &Split<'_>,
    times: &[usize],
    [scale, judged_scale]: [u32; 2],
    config: &Config,
) -> Result<MemoryPlan, TrainError> {
    let drawn = times.iter().sum();
    let training = training_bytes(config, drawn)?;
    let decoding = largest(split.training.iter().chain(&split.held_out), 1, decoding_bytes);
    let scoring = largest(split.held_out.iter(), 1, decoding_bytes).max(largest(
        split.held_out.iter(),
        judged_scale,
        judging_bytes,
    ));
    let kept = |run: u32| kept_bytes(&split.training, times, scale, run);
    let needed = |run: u32| PROGRAM_BYTES + (kept(run) + training.max(decoding)).max(scoring);
    let Some(run) = (1..=Pixels::LONGEST_RUN).find(|run| needed(*run) <= memory.bytes()) else {
        return Err(TrainError::Memory {
            memory,
            photos: drawn,
            needed_mb: needed(Pixels::LONGEST_RUN).div_ceil(1_000_000),
            training_mb: training.div_ceil(1_000_000),
        });
    };
    let free = memory.bytes() - PROGRAM_BYTES - kept(run);
    let at_once = (free / decoding.max(1)).clamp(1, 1 << 16) as usize;
    Ok(MemoryPlan { run, at_once })
}

/// Returns the bytes of the training photos as they are kept.
fn kept_bytes(training: &[NamedFrame<'_>], times: &[usize], scale: u32, run: u32) -> u64 {
    let photos = training.iter().zip(times).map(|(named, times)| {
        let camera = named.frame.camera.box_reduced(scale);
        *times as u64 * Pixels::bytes(camera.width, camera.height, run, named.frame.mask.is_some())
    });
    photos.sum()
}

/// Returns the largest value of `bytes` over the frames.
fn largest<'a>(
    frames: impl Iterator<Item = &'a NamedFrame<'a>>,
    scale: u32,
    bytes: impl Fn(u32, u32) -> u64,
) -> u64 {
    let cameras = frames.map(|named| named.frame.camera.box_reduced(scale));
    cameras
        .map(|camera| bytes(camera.width, camera.height))
        .max()
        .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::split::split;
    use marf_scene::{Camera, Frame, Pose, Scene};
    use marf_schema::train::Holdout;

    fn scene(count: usize, width: u32, height: u32) -> Scene {
        let frame = |index: usize| Frame {
            id: format!("{index:04}"),
            file: format!("{index:04}.png"),
            image: marf_cache::Digest::from_content(b""),
            camera: Camera::pinhole(width, height, 800.0),
            cam_from_world: Pose::identity(),
            held_out: index.is_multiple_of(8),
            mask: None,
            error_px: None,
        };
        Scene {
            frames: (0..count).map(frame).collect(),
            ..Scene::default()
        }
    }

    fn planned(memory: &str, scene: &Scene, scale: u32) -> Result<MemoryPlan, TrainError> {
        let split = split(scene, Holdout::Test, None).unwrap();
        let times = vec![1; split.training.len()];
        let config = Config {
            levels: Some(8),
            log2_table: Some(15),
            ..Config::default()
        };
        plan_memory(memory.parse().unwrap(), &split, &times, [scale; 2], &config)
    }

    #[test]
    fn small_sets_are_kept_whole_and_a_thousand_large_photos_are_thinned_to_fit() {
        let small = planned("4GB", &scene(100, 480, 360), 1).unwrap();
        assert_eq!(small.run, 1);
        // 875 photos of 2 MP are 5.25 GB. One of every 3 pixels, in 4 bytes, is 2.3 GB, and one of every 4 is 1.75 GB.
        let large = scene(1000, 1600, 1250);
        assert_eq!(planned("6GB", &large, 1).unwrap().run, 1);
        assert_eq!(planned("2GB", &large, 1).unwrap().run, 4);
        // Shrunk by 4 they are 328 MB.
        assert_eq!(planned("2GB", &large, 4).unwrap().run, 1);
        assert!(planned("300MB", &large, 1).unwrap().run > 64);
    }

    #[test]
    fn what_fits_in_no_way_is_refused_with_the_number_that_would_do() {
        let large = scene(1000, 1600, 1250);
        let error = planned("100MB", &large, 1).unwrap_err();
        let TrainError::Memory { needed_mb, .. } = &error else {
            panic!("{error}")
        };
        let text = error.to_string();
        assert!(
            text.contains(&format!("{needed_mb} MB")) && text.contains("100MB"),
            "{text}"
        );
        assert!(error.hint().is_some_and(|hint| hint.contains("memory")));
        // The number is enough, and one less is not.
        assert!(planned(&format!("{needed_mb}MB"), &large, 1).unwrap().run > 200);
        assert!(planned(&format!("{}MB", needed_mb - 1), &large, 1).is_err());
    }

    #[test]
    fn as_many_photos_are_decoded_at_once_as_fit_and_at_least_one() {
        let large = scene(1000, 1600, 1250);
        let MemoryPlan { run, at_once } = planned("2GB", &large, 1).unwrap();
        let decoding = decoding_bytes(1600, 1250) * at_once as u64;
        let kept = 875 * Pixels::bytes(1600, 1250, run, false);
        assert!(
            at_once > 2 && PROGRAM_BYTES + kept + decoding <= 2_000_000_000,
            "{at_once}"
        );
        assert!(planned("300MB", &large, 1).unwrap().at_once >= 1);
    }
}
