//! Metric scale and gravity from labels: a model is aligned with the poses of labels and adjusted with them as priors.

use marf_scene::Pose;
use nalgebra::Vector3;

use crate::align::{PosePair, Similarity, Tolerance, align, pose_difference};
use crate::bundle::Prior;
use crate::mapper::{FINE, MapError, MapperInput, Model, refine};

/// The pose of a photo from its label.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelPose {
    /// The pose in the frame of the site.
    pub cam_from_site: Pose,
    /// Rover motion counter: photos with the same one were taken with mast and rover at rest.
    pub motion_counter: Vec<i64>,
    /// Instrument, with its eye (left or right).
    pub instrument: String,
}

/// Rover localisation between stops is accurate to about 5 cm, pointing to 0.3 degrees.
const CENTRE_SIGMA_M: f64 = 0.05;
const ATTITUDE_SIGMA_RAD: f64 = 0.3 * std::f64::consts::PI / 180.0;
/// Error of the calibration of a rigid stereo pair.
const STEREO_SIGMA_M: f64 = 0.001;
const STEREO_SIGMA_RAD: f64 = 0.05 * std::f64::consts::PI / 180.0;
/// Baseline of a stereo pair, metres. A larger one is of another instrument.
const STEREO_BASELINE_M: std::ops::Range<f64> = 0.01..1.0;
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

/// Aligns a model with the frame of its labels and adjusts it with them. Returns the rejected labels.
///
/// The labels with which most photos agree give scale, rotation and translation. They are then priors (5 cm, 0.3
/// degrees, stereo pairs 1 mm and 0.05 degrees) of a last adjustment. `None`, and the model unchanged, if fewer than
/// two labels agree, or fewer than half of those of the model.
pub fn align_to_labels(
    input: &MapperInput<'_>,
    model: &mut Model,
    labels: &[Option<LabelPose>],
) -> Result<Option<Vec<RejectedLabel>>, MapError> {
    let (photos, pairs) = labelled(model, labels);
    let Some(found) = align(&pairs, &TOLERANCE).filter(|found| 2 * found.inliers.len() >= pairs.len()) else {
        return Ok(None);
    };
    model.transform(&found.similarity);
    let trusted: Vec<usize> = found.inliers.iter().map(|&index| photos[index]).collect();
    let priors = priors(model, labels, &trusted);
    refine(input, model, &priors, FINE)?;
    Ok(Some(rejected(model, labels)))
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

/// Returns priors for the trusted labels. Poses are named by their rank among the model's photos.
fn priors(model: &Model, labels: &[Option<LabelPose>], trusted: &[usize]) -> Vec<Prior> {
    let ranks: Vec<usize> = model.photos().collect();
    let rank = |photo: usize| ranks.partition_point(|&other| other < photo) as u32;
    let known: Vec<(usize, &LabelPose)> = trusted
        .iter()
        .filter_map(|&photo| Some((photo, labels[photo].as_ref()?)))
        .collect();
    let mut priors = Vec::new();
    for (index, &(photo, label)) in known.iter().enumerate() {
        priors.push(Prior::Centre {
            pose: rank(photo),
            centre: label.cam_from_site.centre(),
            sigma: CENTRE_SIGMA_M,
        });
        priors.push(Prior::Attitude {
            pose: rank(photo),
            cam_from_world: label.cam_from_site,
            sigma_rad: ATTITUDE_SIGMA_RAD,
        });
        let partners = known[index + 1..]
            .iter()
            .filter(|(_, other)| is_stereo_pair(label, other));
        priors.extend(partners.map(|&(other, partner)| Prior::Relative {
            pose_1: rank(photo),
            pose_2: rank(other),
            cam2_from_cam1: partner.cam_from_site * label.cam_from_site.inverse(),
            sigma_rad: STEREO_SIGMA_RAD,
            sigma: STEREO_SIGMA_M,
        }));
    }
    priors
}

/// Whether two photos are a stereo pair taken at once.
fn is_stereo_pair(a: &LabelPose, b: &LabelPose) -> bool {
    let apart: Vector3<f64> = a.cam_from_site.centre() - b.cam_from_site.centre();
    !a.motion_counter.is_empty()
        && a.motion_counter == b.motion_counter
        && a.instrument != b.instrument
        && STEREO_BASELINE_M.contains(&apart.norm())
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
