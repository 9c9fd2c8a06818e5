//! Why a pair of photos gives no depth.

use thiserror::Error;

use crate::disparities::Swapped;
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
    Swapped(#[from] Swapped),
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

#[cfg(test)]
mod tests {
    use marf_schema::depth::RowOffset;

    use super::*;
    use crate::kept::Sample;
    use crate::raster::Raster;

    /// 100 pixels, of which some have a disparity, with rows that are off.
    fn matched(known: usize, offset_px: f64) -> MatchedPair {
        let sample = |disparity: f32| Sample {
            disparity,
            slope_x: 0.0,
            slope_y: 0.0,
            sigma: 0.2,
            edge: false,
        };
        let mut samples = Raster::filled(10, 10, sample(f32::NAN));
        samples.values[..known].fill(sample(3.0));
        let rows = RowOffset {
            offset_px,
            ..RowOffset::default()
        };
        MatchedPair { samples, rows }
    }

    #[test]
    fn few_matches_and_rows_far_apart_are_faults_and_their_limits_are_not() {
        assert_eq!(fault(&matched(2, 0.0), 100.0), None);
        let few = fault(&matched(1, 9.0), 100.0).unwrap();
        assert_eq!(
            few.to_string(),
            "1.0 % of the pixels match: the photos show too little texture, or not the same"
        );
        // atan(0.8 / 100) is 0.458 degrees, and atan(0.9 / 100) 0.516.
        assert_eq!(fault(&matched(50, -0.8), 100.0), None);
        let rows = fault(&matched(50, -0.9), 100.0).unwrap();
        assert_eq!(
            rows.to_string(),
            "the rows are 0.52 degrees apart, and the limit is 0.5: the mast moved between the photos, or a camera is wrong"
        );
    }

    #[test]
    fn a_photo_of_which_nothing_takes_part_is_named() {
        let whole = Picture::new(Raster::filled(10, 10, 7));
        let mut masked = whole.clone();
        masked.usable.values.fill(false);
        masked.usable.values[0] = true;
        assert_eq!(hidden(&whole, &whole), None);
        assert_eq!(
            hidden(&whole, &masked),
            Some(PairFault::Hidden {
                eye: "right",
                share: 0.01
            })
        );
        assert_eq!(
            hidden(&masked, &whole),
            Some(PairFault::Hidden {
                eye: "left",
                share: 0.01
            })
        );
    }
}
