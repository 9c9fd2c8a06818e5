//! The similarity between two frames from photos that have a pose in both.

use marf_scene::Pose;
use marf_sfm_features::estimators::{log_so3, nearest_rotation};
use nalgebra::{Matrix3, Vector3};

use super::similarity::Similarity;

/// The poses of one photo in two frames.
#[derive(Debug, Clone, Copy)]
pub struct PosePair {
    /// Takes points of the source to the camera.
    pub cam_from_source: Pose,
    /// Takes points of the target to the camera.
    pub cam_from_target: Pose,
}

/// Largest difference of the poses of an inlier.
#[derive(Debug, Clone, Copy)]
pub struct Tolerance {
    /// Between camera centres, in the unit of the target.
    pub distance: f64,
    /// Between attitudes.
    pub angle_rad: f64,
}

/// A similarity with its inliers.
#[derive(Debug, Clone)]
pub struct Alignment {
    /// Target world from source world.
    pub similarity: Similarity,
    /// Indices of the photos within the tolerance, sorted.
    pub inliers: Vec<usize>,
}

/// Rounds of fitting to the inliers.
const ROUNDS: usize = 5;
/// Largest number of photos whose pairs are tried, evenly chosen.
const MAX_TRIED: usize = 40;

/// Returns the similarity with most inliers among photos that have a pose in both frames.
///
/// Attitudes give the rotation, centres give scale and translation, so that two photos suffice and collinear centres
/// do no harm. Every pair of photos is a hypothesis, and the one with most inliers is fitted to them. `None` with
/// fewer than two photos, if all centres coincide, or if no two photos agree.
pub fn align(pairs: &[PosePair], tolerance: &Tolerance) -> Option<Alignment> {
    let mut best: Option<Alignment> = None;
    let tried: Vec<usize> = evenly_spaced(pairs.len());
    for (rank, &i) in tried.iter().enumerate() {
        for &j in &tried[rank + 1..] {
            let candidate = fit(pairs, &[i, j]).map(|similarity| score(pairs, similarity, tolerance));
            let more = |one: &Alignment| {
                best.as_ref()
                    .is_none_or(|best| one.inliers.len() > best.inliers.len())
            };
            best = candidate.filter(more).or(best);
        }
    }
    let mut best = best.filter(|best| best.inliers.len() >= 2)?;
    for _ in 0..ROUNDS {
        let Some(similarity) = fit(pairs, &best.inliers) else {
            break;
        };
        let next = score(pairs, similarity, tolerance);
        if next.inliers.len() < best.inliers.len() {
            break;
        }
        let same = next.inliers == best.inliers;
        best = next;
        if same {
            break;
        }
    }
    Some(best)
}

/// Returns at most 40 indices, evenly spaced.
fn evenly_spaced(count: usize) -> Vec<usize> {
    let tried = count.min(MAX_TRIED);
    (0..tried).map(|index| index * count / tried).collect()
}

/// Returns a similarity with its inliers.
fn score(pairs: &[PosePair], similarity: Similarity, tolerance: &Tolerance) -> Alignment {
    let agrees = |index: &usize| {
        let (distance, angle_rad) = pose_difference(&pairs[*index], &similarity);
        distance <= tolerance.distance && angle_rad <= tolerance.angle_rad
    };
    let inliers = (0..pairs.len()).filter(agrees).collect();
    Alignment { similarity, inliers }
}

/// Returns the distance between centres, in the unit of the target, and the angle between attitudes.
pub fn pose_difference(pair: &PosePair, similarity: &Similarity) -> (f64, f64) {
    let moved = similarity.pose(&pair.cam_from_source);
    let rotation = moved.rotation * pair.cam_from_target.rotation.transpose();
    (
        (moved.centre() - pair.cam_from_target.centre()).norm(),
        log_so3(&rotation).norm(),
    )
}

/// Returns the similarity of least squares over some photos.
fn fit(pairs: &[PosePair], chosen: &[usize]) -> Option<Similarity> {
    let count = chosen.len() as f64;
    let sum: Matrix3<f64> = chosen
        .iter()
        .map(|&index| &pairs[index])
        .map(|pair| pair.cam_from_target.rotation.transpose() * pair.cam_from_source.rotation)
        .sum();
    let rotation = nearest_rotation(&sum);
    let mean = |side: fn(&PosePair) -> Vector3<f64>| {
        chosen
            .iter()
            .map(|&index| side(&pairs[index]))
            .sum::<Vector3<f64>>()
            / count
    };
    let source = |pair: &PosePair| pair.cam_from_source.centre();
    let target = |pair: &PosePair| pair.cam_from_target.centre();
    let (mean_source, mean_target) = (mean(source), mean(target));
    let (mut along, mut squared) = (0.0, 0.0);
    for &index in chosen {
        let from = source(&pairs[index]) - mean_source;
        along += (target(&pairs[index]) - mean_target).dot(&(rotation * from));
        squared += from.norm_squared();
    }
    let scale = along / squared;
    let translation = mean_target - scale * (rotation * mean_source);
    (scale.is_finite() && scale > 0.0).then_some(Similarity {
        scale,
        rotation,
        translation,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(index: usize) -> Pose {
        let at = index as f64;
        Pose::looking_at(
            Vector3::new(at, 0.3 * at * at, 5.0 - at),
            Vector3::new(0.1 * at, 0.0, 20.0),
            Vector3::y(),
        )
    }

    /// Scale 3, a rotation about z, and a translation of kilometres.
    fn truth() -> Similarity {
        Similarity {
            scale: 3.0,
            rotation: Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0),
            translation: Vector3::new(1e4, -2e4, 5.0),
        }
    }

    fn pair(index: usize) -> PosePair {
        PosePair {
            cam_from_source: pose(index),
            cam_from_target: truth().pose(&pose(index)),
        }
    }

    const CLOSE: Tolerance = Tolerance {
        distance: 0.1,
        angle_rad: 0.01,
    };

    #[test]
    fn two_photos_suffice_and_centres_in_a_line_do_no_harm() {
        for count in [2, 3, 9] {
            let pairs: Vec<PosePair> = (0..count).map(pair).collect();
            let found = align(&pairs, &CLOSE).unwrap();
            assert_eq!(found.inliers.len(), count, "{count}");
            assert!(
                (found.similarity.scale - 3.0).abs() < 1e-9,
                "{}",
                found.similarity.scale
            );
            assert!((found.similarity.translation - truth().translation).norm() < 1e-6);
        }
    }

    #[test]
    fn photos_whose_label_is_wrong_are_outvoted() {
        let mut pairs: Vec<PosePair> = (0..9).map(pair).collect();
        for index in [1, 4, 8] {
            pairs[index].cam_from_target.translation += Vector3::new(30.0, index as f64, 2.0);
        }
        let found = align(&pairs, &CLOSE).unwrap();
        assert_eq!(found.inliers, [0, 2, 3, 5, 6, 7]);
        assert!((found.similarity.scale - 3.0).abs() < 1e-9);
    }

    #[test]
    fn one_photo_or_one_place_gives_no_answer() {
        let one = pair(1);
        assert!(align(&[one], &CLOSE).is_none());
        assert!(align(&[one, one, one], &CLOSE).is_none());
        assert!(align(&[], &CLOSE).is_none());
    }
}
