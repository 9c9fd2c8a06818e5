//! Metres and gravity from labels: a model is brought into the labels' site and adjusted with them as priors.

use marf_scene::Pose;
use nalgebra::Vector3;

use crate::align::{Tolerance, align, disagreement};
use crate::bundle::Prior;
use crate::estimators::Similarity;
use crate::mapper::{FINE, MapError, Model, Task, settle};

/// What a label says of a photo.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LabelPose {
    pub cam_from_site: Pose,
    /// Rover motion counter: photos with the same one were taken with mast and rover at rest.
    pub motion_counter: Vec<i64>,
    /// Instrument and eye.
    pub instrument: String,
}

/// Between stops rover localisation is good to about 5 cm, pointing to 0.3 degrees.
const CENTRE_SIGMA_M: f64 = 0.05;
const ATTITUDE_SIGMA_RAD: f64 = 0.3 * std::f64::consts::PI / 180.0;
/// Two eyes on one bar: what the calibration of the pair leaves.
const EYES_SIGMA_M: f64 = 0.001;
const EYES_SIGMA_RAD: f64 = 0.05 * std::f64::consts::PI / 180.0;
/// Eyes are this far apart, metres; more is another instrument.
const EYES_M: std::ops::Range<f64> = 0.01..1.0;
/// Labels farther off than this are outvoted: six sigma.
const TOLERANCE: Tolerance = Tolerance {
    distance: 6.0 * CENTRE_SIGMA_M,
    angle_rad: 6.0 * ATTITUDE_SIGMA_RAD,
};

/// A label the photos outvoted.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Outvoted {
    pub photo: usize,
    pub distance_m: f64,
    pub angle_rad: f64,
}

/// Brings a model into the site of its labels and adjusts it with them.
///
/// The labels most photos agree with give scale, turn and place; as soft residuals (5 cm, 0.3 degrees, eyes of
/// one exposure 1 mm and 0.05 degrees) they then take part in a last adjustment. `None` where fewer than two
/// labels agree, or fewer than half of those the model has.
pub(crate) fn place(
    task: &Task<'_>,
    model: &mut Model,
    labels: &[Option<LabelPose>],
) -> Result<Option<Vec<Outvoted>>, MapError> {
    let (photos, pairs) = labelled(model, labels);
    let Some(found) = align(&pairs, &TOLERANCE).filter(|found| 2 * found.inliers.len() >= pairs.len()) else {
        return Ok(None);
    };
    transform(model, &found.similarity);
    let trusted: Vec<usize> = found.inliers.iter().map(|&index| photos[index]).collect();
    let priors = priors(model, labels, &trusted);
    settle(task, model, &priors, FINE)?;
    Ok(Some(outvoted(model, labels)))
}

/// Photos of the model that have a label, with both poses.
fn labelled(model: &Model, labels: &[Option<LabelPose>]) -> (Vec<usize>, Vec<(Pose, Pose)>) {
    let both = model.photos().filter_map(|photo| {
        Some((
            photo,
            (model.poses[photo]?, labels[photo].as_ref()?.cam_from_site),
        ))
    });
    both.unzip()
}

/// Carries poses and points over.
pub(crate) fn transform(model: &mut Model, similarity: &Similarity) {
    for pose in model.poses.iter_mut().flatten() {
        *pose = similarity.pose(pose);
    }
    for point in model.points.iter_mut().flatten() {
        *point = similarity.point(point);
    }
}

/// Residuals of the labels that agree; poses are named by their rank among the model's photos.
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
        let partners = known[index + 1..].iter().filter(|(_, other)| eyes(label, other));
        priors.extend(partners.map(|&(other, partner)| Prior::Relative {
            pose_1: rank(photo),
            pose_2: rank(other),
            cam2_from_cam1: partner.cam_from_site * label.cam_from_site.inverse(),
            sigma_rad: EYES_SIGMA_RAD,
            sigma: EYES_SIGMA_M,
        }));
    }
    priors
}

/// Tells whether two photos are the two eyes of one exposure.
pub(crate) fn eyes(a: &LabelPose, b: &LabelPose) -> bool {
    let apart: Vector3<f64> = a.cam_from_site.centre() - b.cam_from_site.centre();
    !a.motion_counter.is_empty()
        && a.motion_counter == b.motion_counter
        && a.instrument != b.instrument
        && EYES_M.contains(&apart.norm())
}

fn outvoted(model: &Model, labels: &[Option<LabelPose>]) -> Vec<Outvoted> {
    let (photos, pairs) = labelled(model, labels);
    let far = photos.into_iter().zip(&pairs).filter_map(|(photo, pair)| {
        let (distance_m, angle_rad) = disagreement(pair, &UNMOVED);
        let far = distance_m > TOLERANCE.distance || angle_rad > TOLERANCE.angle_rad;
        far.then_some(Outvoted {
            photo,
            distance_m,
            angle_rad,
        })
    });
    far.collect()
}

const UNMOVED: Similarity = Similarity {
    scale: 1.0,
    rotation: nalgebra::Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
    translation: Vector3::new(0.0, 0.0, 0.0),
};
