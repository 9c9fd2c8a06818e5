//! Why a pair of photos gives no depth.

use thiserror::Error;

use crate::disparities::MatchError;
use crate::kept::MatchedPair;
use crate::raster::Picture;

/// Fewest pixels of a rectified photo that take part, as a share.
const LEAST_SHOWN: f64 = 0.02;
/// Fewest pixels with a disparity, as a share: chance alone gives some.
const LEAST_MATCHED: f64 = 0.02;
/// With rows farther apart, in degrees, the direction along the rows is as wrong, and no photo shows it.
const MOST_ROWS_DEG: f64 = 0.5;

/// Why a pair of photos gives no depth.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub(crate) enum PairFault {
    #[error(
        "{:.1} % of the rectified {eye} photo can be used: the rest is masked, black, burnt out, or outside the other photo", 100.0 * share
    )]
    Hidden { eye: &'static str, share: f64 },
    #[error(transparent)]
    Match(#[from] MatchError),
    #[error("{:.1} % of the pixels match: the photos show too little texture, or not the same", 100.0 * share)]
    FewMatches { share: f64 },
    #[error(
        "the rows are {degrees:.2} degrees apart, and the limit is {MOST_ROWS_DEG}: the mast moved between the photos, or a camera is wrong"
    )]
    Rows { degrees: f64 },
}

/// Returns why the rectified photos cannot be matched.
pub(crate) fn hidden(left: &Picture, right: &Picture) -> Option<PairFault> {
    let eyes = [("left", left), ("right", right)];
    let mut shares = eyes.into_iter().map(|(eye, picture)| {
        let used = picture.usable.values.iter().filter(|usable| **usable).count();
        let share = used as f64 / picture.usable.values.len().max(1) as f64;
        PairFault::Hidden { eye, share }
    });
    shares.find(|fault| matches!(fault, PairFault::Hidden { share, .. } if *share < LEAST_SHOWN))
}

/// Returns why a pair that was matched gives no depth.
pub(crate) fn fault(matched: &MatchedPair, focal_px: f64) -> Option<PairFault> {
    let known = matched.samples.values.iter().filter(|sample| sample.is_some());
    let share = known.count() as f64 / matched.samples.values.len().max(1) as f64;
    if share < LEAST_MATCHED {
        return Some(PairFault::FewMatches { share });
    }
    let degrees = libm::atan(matched.rows.offset_px.abs() / focal_px).to_degrees();
    (degrees > MOST_ROWS_DEG).then_some(PairFault::Rows { degrees })
}
