//! Rigs: whether the two eyes of a stereo camera stand to each other as their labels say.

use marf_numeric::upper_median;
use marf_scene::Pose;
use marf_sfm_features::estimators::log_so3;
use nalgebra::{Matrix3, Matrix6, Vector3};

use crate::mapper::{MapperInput, Model, own_covariances};

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

impl LabelPose {
    /// Whether two photos were taken from one stop: with one site, drive and pose.
    pub(crate) fn is_of_stop(&self, other: &Self) -> bool {
        let stop = self.motion_counter.get(..3);
        stop.is_some() && stop == other.motion_counter.get(..3)
    }
}

/// Error of the calibration of a rigid stereo pair.
pub(crate) const STEREO_SIGMA_M: f64 = 0.001;
pub(crate) const STEREO_SIGMA_RAD: f64 = 0.05 * std::f64::consts::PI / 180.0;
/// Baseline of a stereo pair, metres. A larger one is of another instrument.
const BASELINE_M: std::ops::Range<f64> = 0.01..1.0;
/// Labels and photos differ beyond this many sigma.
const MOST_SIGMAS: f64 = 4.0;
/// The photos tell nothing if their sigma is larger than this many of the labels.
const MOST_PHOTO_SIGMAS: f64 = 2.0;
/// With fewer pairs, their common ratio of lengths hides a wrong length.
const FEWEST_PAIRS: usize = 3;

/// What the photos say about the relative pose of a stereo pair by its labels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RigVerdict {
    /// It agrees with the photos.
    Rigid,
    /// It differs beyond the errors of both.
    Differs,
    /// The photos do not determine it.
    Unclear,
}

/// A stereo pair with the difference between its relative pose by the labels and by the photos.
#[derive(Debug, Clone, PartialEq)]
pub struct StereoPair {
    /// Indices of the photos.
    pub photos: [usize; 2],
    /// The relative pose by the labels.
    pub cam2_from_cam1: Pose,
    /// Angle between the relative attitudes.
    pub angle_rad: f64,
    /// Distance between the ends of the baselines, with the lengths of the photos by the common ratio of all pairs.
    pub distance_m: f64,
    /// The verdict.
    pub verdict: RigVerdict,
}

/// Returns the stereo pairs of a model in metres, which is not yet adjusted to the labels.
///
/// `scale_sigma`: relative error of its scale by the positions of the stops.
pub(crate) fn stereo_pairs(
    input: &MapperInput<'_>,
    model: &Model,
    labels: &[Option<LabelPose>],
    scale_sigma: f64,
) -> Vec<StereoPair> {
    let photos: Vec<usize> = model.photos().collect();
    let covariances = own_covariances(input, model);
    let eyes: Vec<Eye<'_>> = photos
        .iter()
        .zip(covariances)
        .filter_map(|(&photo, covariance)| {
            Some(Eye {
                photo,
                label: labels[photo].as_ref()?,
                pose: model.poses[photo]?,
                covariance,
            })
        })
        .collect();
    let pairs = eyes.iter().enumerate().flat_map(|(index, first)| {
        let partners = eyes[index + 1..].iter();
        partners
            .filter(|second| are_stereo(first.label, second.label))
            .map(move |second| [first, second])
    });
    let pairs: Vec<[&Eye<'_>; 2]> = pairs.collect();
    let lengths = pairs.iter().map(|[first, second]| {
        let length = |a: &Pose, b: &Pose| (a.centre() - b.centre()).norm();
        length(&first.label.cam_from_site, &second.label.cam_from_site) / length(&first.pose, &second.pose)
    });
    let ratio = upper_median(lengths).unwrap_or(1.0);
    let mut found: Vec<StereoPair> = pairs.iter().map(|pair| compared(pair, ratio)).collect();
    let is_contradicted = libm::log(ratio).abs() > MOST_SIGMAS * scale_sigma;
    for pair in &mut found {
        if is_contradicted {
            pair.verdict = RigVerdict::Differs;
        } else if pairs.len() < FEWEST_PAIRS && pair.verdict == RigVerdict::Rigid {
            pair.verdict = RigVerdict::Unclear;
        }
    }
    found
}

/// A photo of a stereo pair.
struct Eye<'a> {
    photo: usize,
    label: &'a LabelPose,
    pose: Pose,
    covariance: Option<Matrix6<f64>>,
}

/// Whether two photos are a stereo pair taken at once.
fn are_stereo(a: &LabelPose, b: &LabelPose) -> bool {
    let apart: Vector3<f64> = a.cam_from_site.centre() - b.cam_from_site.centre();
    !a.motion_counter.is_empty()
        && a.motion_counter == b.motion_counter
        && a.instrument != b.instrument
        && BASELINE_M.contains(&apart.norm())
}

/// Compares the relative pose of a pair by its labels with that by the photos, whose lengths are multiplied by `ratio`.
fn compared([first, second]: &[&Eye<'_>; 2], ratio: f64) -> StereoPair {
    let cam2_from_cam1 = second.label.cam_from_site * first.label.cam_from_site.inverse();
    let found = second.pose * first.pose.inverse();
    let turn = log_so3(&(found.rotation * cam2_from_cam1.rotation.transpose()));
    let shift = found.translation * ratio - cam2_from_cam1.translation;
    let mut pair = StereoPair {
        photos: [first.photo, second.photo],
        cam2_from_cam1,
        angle_rad: turn.norm(),
        distance_m: shift.norm(),
        verdict: RigVerdict::Unclear,
    };
    let (Some(of_first), Some(of_second)) = (first.covariance, second.covariance) else {
        return pair;
    };
    let part = |covariance: &Matrix6<f64>, at: usize| -> Matrix3<f64> {
        covariance.fixed_view::<3, 3>(at, at).into()
    };
    let turned =
        |rotation: &Matrix3<f64>, covariance: Matrix3<f64>| rotation * covariance * rotation.transpose();
    let turn_covariance = turned(&found.rotation, part(&of_first, 0)) + part(&of_second, 0);
    let shift_covariance = turned(&second.pose.rotation, part(&of_first, 3) + part(&of_second, 3));
    let angle = Deviation::new(&turn, &turn_covariance, STEREO_SIGMA_RAD);
    let distance = Deviation::new(&shift, &shift_covariance, STEREO_SIGMA_M);
    pair.verdict = if angle.sigmas.max(distance.sigmas) > MOST_SIGMAS {
        RigVerdict::Differs
    } else if angle.photo_sigma.max(distance.photo_sigma) > MOST_PHOTO_SIGMAS {
        RigVerdict::Unclear
    } else {
        RigVerdict::Rigid
    };
    pair
}

/// A difference between labels and photos.
struct Deviation {
    /// In sigma of both together.
    sigmas: f64,
    /// Sigma of the photos in that of the labels.
    photo_sigma: f64,
}

impl Deviation {
    fn new(off: &Vector3<f64>, covariance: &Matrix3<f64>, label_sigma: f64) -> Self {
        let both = covariance + Matrix3::identity() * (label_sigma * label_sigma);
        let squared = both
            .try_inverse()
            .map_or(f64::INFINITY, |inverse| off.dot(&(inverse * off)));
        Self {
            sigmas: squared.sqrt(),
            photo_sigma: (covariance.trace() / 3.0).sqrt() / label_sigma,
        }
    }
}
