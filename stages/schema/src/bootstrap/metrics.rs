//! Results of a bootstrap: its members, its maps and the held-out photos.

use marf_cache::Digest;
use serde::{Deserialize, Serialize};

use super::Mode;

/// Output `members` of `bootstrap`: the fields of its members, in order, for `render`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct MemberFields(pub Vec<Digest>);

/// Output `metrics` of `bootstrap`. Spreads are of sRGB in [0, 1], means over all pixels of all viewpoints.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Members.
    pub b: u32,
    /// What differs between them.
    pub mode: Mode,
    /// Mean sample standard deviation of gray, divisor B - 1.
    pub std: f64,
    /// The paper's figure: mean standard deviation of gray, divisor B.
    pub std_paper: f64,
    /// Mean sample standard deviation of each channel.
    pub std_rgb: [f64; 3],
    /// Mean term of what no photo saw: (1 - c)², c the share of a pixel that photos have seen.
    pub unseen_term: f64,
    /// Mean total standard deviation: √(divisor-B variance + that term + r²). r is the root mean square error
    /// of gray of a member where the photos it was trained on show the same.
    pub total_sd: f64,
    /// Mean sample standard deviation of the depth where there is one, world units.
    pub depth_std: Option<f64>,
    /// Share of pixels that the photos saw less than half of.
    pub unseen_share: f64,
    /// Share of pixels that show sky which photos saw.
    pub sky_share: f64,
    /// The members, in order.
    pub members: Vec<Member>,
    /// Photos compared with the members that did not draw them. Only in mode `photos`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub out_of_bag: Option<OutOfBag>,
    /// Errors on the held-out photos. `None` if the viewpoints are not photos.
    pub heldout: Option<HeldOut>,
    /// Every viewpoint.
    pub views: Vec<ViewReport>,
}

/// Photos trained on, shrunk to at most 160 pixels, compared with the mean of the members that did not draw them, and that did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OutOfBag {
    /// Photos that at least one member did not draw.
    pub photos: u64,
    /// Mean PSNR of the means of those that did not, dB.
    pub psnr: f64,
    /// Mean PSNR of the means of those that did, of the same photos, dB. `None` if no photo has both.
    pub psnr_in_bag: Option<f64>,
}

/// A member, from its own metrics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Member {
    /// Its seed.
    pub seed: u64,
    /// Factor by which its photos were shrunk.
    pub scale: u32,
    /// Mean PSNR on the photos held out, dB.
    pub psnr: f64,
    /// Mean SSIM on them.
    pub ssim: Option<f64>,
}

/// One viewpoint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ViewReport {
    /// Name of its maps.
    pub name: String,
    /// Mean sample standard deviation of gray.
    pub std: f64,
    /// The same with divisor B.
    pub std_paper: f64,
    /// Mean term of what no photo saw.
    pub unseen_term: f64,
    /// Mean total standard deviation.
    pub total_sd: f64,
    /// Mean standard deviation of the depth where there is one, world units.
    pub depth_std: Option<f64>,
    /// Share of pixels that the photos saw less than half of.
    pub unseen_share: f64,
    /// Share of pixels that show sky which photos saw.
    pub sky_share: f64,
    /// Number of the place of a photo: photos of one place stand near each other and look the same way.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<u64>,
    /// How well the spread ranks the errors. `None` without a photo.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub photo: Option<PhotoReport>,
}

/// A viewpoint compared with its photo. Errors are |mean gray - gray of the photo|.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PhotoReport {
    /// PSNR of the mean render, dB.
    pub psnr: f64,
    /// Area under the sparsification error by the standard deviation, mean absolute error.
    pub ause_mae: f64,
    /// Of a random order.
    pub ause_mae_random: f64,
    /// Root mean squared error.
    pub ause_rmse: f64,
    /// Of a random order.
    pub ause_rmse_random: f64,
    /// By the total standard deviation, mean absolute error.
    pub ause_mae_total: f64,
    /// Rank correlation of standard deviation and error.
    pub spearman: f64,
}

/// Statistics of the spread on the held-out photos.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HeldOut {
    /// Means of [`PhotoReport`] over photos, `spearman` as the median.
    #[serde(flatten)]
    pub mean: PhotoReport,
    /// Errors that are left when the most uncertain pixels are taken away.
    pub sparsification: SparsificationCurves,
    /// Mean of the members' own PSNR, dB: what averaging gains is the difference.
    pub psnr_members_mean: f64,
    /// Share of pixels whose error lies within the spread.
    pub coverage: Coverage,
    /// These shares for normal errors with that spread.
    pub coverage_nominal: Coverage,
    /// Mean negative log-likelihood of the errors, nats, to six decimals.
    pub nll: f64,
    /// The 90 % interval of gray, in sRGB of [0, 1]. `None` with fewer than two held-out places.
    pub calibration: Option<Calibration>,
    /// The 90 % interval of the depth, as shares of the depth, from the sparse points that the photos show.
    /// `None` with fewer than two places or 100 points.
    pub depth_calibration: Option<Calibration>,
}

/// Mean absolute error of gray, sRGB in [0, 1], of the remaining pixels, as a mean over photos. One value for
/// each of `removed`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SparsificationCurves {
    /// Shares of the pixels that are taken away.
    pub removed: Vec<f64>,
    /// Those with the largest standard deviation first.
    pub by_std: Vec<f64>,
    /// Those with the largest total deviation first.
    pub by_total: Vec<f64>,
    /// Those with the largest error first: no order is better.
    pub best: Vec<f64>,
}

/// Shares of pixels whose error is at most 1, 2 and 3 standard deviations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Coverage {
    /// Within one.
    pub sd1: f64,
    /// Within two.
    pub sd2: f64,
    /// Within three.
    pub sd3: f64,
}

/// Intervals fitted on the photos held out, and how far they hold at places they were not fitted on: each place is left out in turn.
///
/// The spread of a pixel is √(v + r² + floor²). v is the mean variance of the members over 5 x 5 pixels
/// around it. r of gray is the error of a member where the photos it was trained on show the same. r of
/// depths is 0.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Least spread: noise, and what no field resolves.
    pub floor: f64,
    /// 68.3 % of the errors are at most this many spreads.
    pub t: f64,
    /// 90 % of the errors are at most this many spreads: half of the width of the interval that maps show.
    pub factor90: f64,
    /// Mean |share inside - stated share| over the 19 intervals of `inside`, at the place left out, as a mean over places.
    pub ece: f64,
    /// Least and largest of a place.
    pub ece_range: [f64; 2],
    /// Share of the errors at the place left out within intervals of stated shares 0.05, 0.10, .. 0.95, each fitted at the other places as
    /// that of 0.90 is, as a mean over places.
    pub inside: Vec<f64>,
    /// Share of the errors at the place left out that its 90 % interval covers, as a mean over places. One of `inside`.
    pub coverage90: f64,
    /// Least and largest of a place.
    pub coverage90_range: [f64; 2],
    /// Half of the errors at all places are at most this.
    pub median_error: f64,
    /// Half of the width of the 90 % interval, at the pixel with the median spread.
    pub median_half90: f64,
    /// Places.
    pub places: u64,
    /// Photos.
    pub views: u64,
    /// Pixels whose errors were compared, at most 16,384 a photo, evenly spaced.
    pub errors: u64,
    /// Share of pixels without an interval, since no photo trained on saw them.
    pub unseen_share: f64,
    /// Caveats.
    pub note: String,
}
