//! Metric scale and gravity from labels: a model is aligned with the poses of labels and adjusted with them as priors.

use marf_scene::Pose;
use nalgebra::Vector3;

use crate::align::{PosePair, Similarity, Tolerance, align, pose_difference};
use crate::bundle::Prior;
use crate::mapper::{FINE, MapError, MapperInput, Model, refine};
use crate::rigs::{LabelPose, RigVerdict, STEREO_SIGMA_M, STEREO_SIGMA_RAD, StereoPair, stereo_pairs};

/// Rover localisation between stops is accurate to about 5 cm, pointing to 0.3 degrees.
const CENTRE_SIGMA_M: f64 = 0.05;
const ATTITUDE_SIGMA_RAD: f64 = 0.3 * std::f64::consts::PI / 180.0;
/// Labels farther off than this are rejected: six sigma.
const TOLERANCE: Tolerance = Tolerance {
    distance: 6.0 * CENTRE_SIGMA_M,
    angle_rad: 6.0 * ATTITUDE_SIGMA_RAD,
};

/// A label that disagrees with the photos.
#[derive(Debug, Clone, PartialEq)]
pub struct RejectedLabel {
    /// Index of the photo.
    pub photo: usize,
    /// Distance of the centre from that of the label.
    pub distance_m: f64,
    /// Angle of the attitude from that of the label.
    pub angle_rad: f64,
}

/// What the alignment of a model with its labels says of them.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelAgreement {
    /// The labels that disagree with the photos.
    pub rejected: Vec<RejectedLabel>,
    /// The stereo pairs, as the photos alone show them.
    pub stereo_pairs: Vec<StereoPair>,
}

/// Aligns a model with the frame of its labels and adjusts it with them.
///
/// The labels with which most photos agree give scale, rotation and translation. They are then priors (5 cm, 0.3
/// degrees) of a last adjustment, and so are the relative poses of stereo pairs (1 mm, 0.05 degrees) that the photos do
/// not contradict. `None`, and the model unchanged, if fewer than two labels agree, or fewer than half of those of the
/// model.
pub fn align_to_labels(
    input: &MapperInput<'_>,
    model: &mut Model,
    labels: &[Option<LabelPose>],
) -> Result<Option<LabelAgreement>, MapError> {
    let (photos, pairs) = labelled(model, labels);
    let Some(found) = align(&pairs, &TOLERANCE).filter(|found| 2 * found.inliers.len() >= pairs.len()) else {
        return Ok(None);
    };
    model.transform(&found.similarity);
    let trusted: Vec<usize> = found.inliers.iter().map(|&index| photos[index]).collect();
    let stereo_pairs = stereo_pairs(input, model, labels, scale_sigma(model));
    let rank = |photo: usize| model.photos().take_while(|&other| other < photo).count() as u32;
    let mut priors = stop_priors(labels, &trusted, &rank);
    priors.extend(rig_priors(&stereo_pairs, &trusted, &rank));
    refine(input, model, &priors, FINE)?;
    Ok(Some(LabelAgreement {
        rejected: rejected(model, labels),
        stereo_pairs,
    }))
}

/// Returns the relative error of the scale of a model by the positions of its photos' labels.
fn scale_sigma(model: &Model) -> f64 {
    let centres: Vec<_> = model.poses.iter().flatten().map(Pose::centre).collect();
    let count = centres.len() as f64;
    let mean = centres.iter().sum::<Vector3<f64>>() / count;
    let squared: f64 = centres.iter().map(|centre| (centre - mean).norm_squared()).sum();
    CENTRE_SIGMA_M / (squared / count).sqrt()
}

/// Returns the photos of the model that have a label, with both poses.
fn labelled(model: &Model, labels: &[Option<LabelPose>]) -> (Vec<usize>, Vec<PosePair>) {
    let both = model.photos().filter_map(|photo| {
        let pair = PosePair {
            cam_from_source: model.poses[photo]?,
            cam_from_target: labels[photo].as_ref()?.cam_from_site,
        };
        Some((photo, pair))
    });
    both.unzip()
}

/// Returns priors for the trusted labels. `rank` names a photo's pose. The photos of a stop share the error of its
/// position, so that all of them together count as one.
fn stop_priors(labels: &[Option<LabelPose>], trusted: &[usize], rank: &dyn Fn(usize) -> u32) -> Vec<Prior> {
    let known: Vec<(usize, &LabelPose)> = trusted
        .iter()
        .filter_map(|&photo| Some((photo, labels[photo].as_ref()?)))
        .collect();
    let of_photo = |&(photo, label): &(usize, &LabelPose)| {
        let at_stop = known.iter().filter(|(_, other)| label.is_of_stop(other)).count();
        [
            Prior::Centre {
                pose: rank(photo),
                centre: label.cam_from_site.centre(),
                sigma: CENTRE_SIGMA_M * (at_stop.max(1) as f64).sqrt(),
            },
            Prior::Attitude {
                pose: rank(photo),
                cam_from_world: label.cam_from_site,
                sigma_rad: ATTITUDE_SIGMA_RAD,
            },
        ]
    };
    known.iter().flat_map(of_photo).collect()
}

/// Returns priors for stereo pairs that the photos do not contradict: rigid ones, and others of two trusted labels.
fn rig_priors(pairs: &[StereoPair], trusted: &[usize], rank: &dyn Fn(usize) -> u32) -> Vec<Prior> {
    let is_kept = |pair: &&StereoPair| match pair.verdict {
        RigVerdict::Rigid => true,
        RigVerdict::Differs => false,
        RigVerdict::Unclear => pair.photos.iter().all(|photo| trusted.contains(photo)),
    };
    let prior = |pair: &StereoPair| Prior::Relative {
        pose_1: rank(pair.photos[0]),
        pose_2: rank(pair.photos[1]),
        cam2_from_cam1: pair.cam2_from_cam1,
        sigma_rad: STEREO_SIGMA_RAD,
        sigma: STEREO_SIGMA_M,
    };
    pairs.iter().filter(is_kept).map(prior).collect()
}

/// Returns the labels that are farther off than the tolerance.
fn rejected(model: &Model, labels: &[Option<LabelPose>]) -> Vec<RejectedLabel> {
    let (photos, pairs) = labelled(model, labels);
    let far = photos.into_iter().zip(&pairs).filter_map(|(photo, pair)| {
        let (distance_m, angle_rad) = pose_difference(pair, &Similarity::identity());
        let far = distance_m > TOLERANCE.distance || angle_rad > TOLERANCE.angle_rad;
        far.then_some(RejectedLabel {
            photo,
            distance_m,
            angle_rad,
        })
    });
    far.collect()
}
