//! The filter `histogram`.

mod paper;
mod params;
mod robust;
mod usual;

use marf_stage::ParamError;

use crate::by_hand::ByHand;
use crate::decision::Decision;
use crate::decoded::DecodedPhoto;
use crate::filter::{AnyPass, Filter, MeasuredPhoto, check_range};
#[cfg(test)]
use crate::section::Guard;
use crate::tones::{ToneHistograms, tones};
use paper::SumsPass;
pub use params::Histogram;
use params::{HistogramParams, HistogramRule};
use robust::{DistancesPass, SharesPass};
use usual::UsualHistogram;

impl Filter for Histogram {
    const NAME: &'static str = "histogram";
    const ABOUT: &'static str = "rejects photos whose brightness or colours do not belong to the set";
    const RELAX: &'static str = "a higher `max_flat` or `max_clipped`";
    const MEASURE_VERSION: u32 = 4;
    const DECISION_VERSION: u32 = 1;
    type Params = HistogramParams;
    type Measure = ToneHistograms;
    type Context = UsualHistogram;
    const MEASURE: Option<fn(&DecodedPhoto<'_>) -> ToneHistograms> = Some(tones);

    #[cfg(test)]
    const GUARD: Guard = Guard {
        measures: "4 1095ef887208",
        decisions: "5 d80c6297095b",
    };

    fn by_hand(params: &HistogramParams) -> &ByHand {
        &params.by_hand
    }

    fn check(params: &HistogramParams) -> Result<(), ParamError> {
        check_range("max_flat", params.max_flat, 0.0, 1.0)?;
        check_range("max_clipped", params.max_clipped, 0.0, 1.0)?;
        check_range("min_light", params.min_light, 0.0, 512.0)?;
        check_range("min_distance", params.min_distance, 0.0, 512.0)?;
        check_range("spreads", params.spreads, 0.0, 1e6)?;
        check_range("max_bins", params.max_bins, 0.0, 1.0)?;
        check_range("sigmas", params.sigmas, 0.0, 1e6)
    }

    fn passes(params: &HistogramParams) -> &'static [&'static dyn AnyPass<Self>] {
        match params.rule {
            HistogramRule::Robust => &[&SharesPass, &DistancesPass],
            HistogramRule::Paper => &[&SumsPass],
        }
    }

    /// The statistics change with nearly every new photo, so most new sols decide all sols again. For 1,000,000
    /// photos this reads 0.5 to 1.4 GB of kept measures, a window at a time.
    fn decide(
        params: &HistogramParams,
        usual: Option<&UsualHistogram>,
        photo: &MeasuredPhoto<'_, ToneHistograms>,
    ) -> Decision {
        let tones = &photo.measure;
        match (usual, params.rule) {
            (Some(UsualHistogram::Robust(usual)), _) => robust::decide(params, Some(usual), tones),
            (Some(UsualHistogram::Paper(usual)), _) => paper::decide(params, usual, tones),
            (None, HistogramRule::Robust) => robust::decide(params, None, tones),
            (None, HistogramRule::Paper) => Decision::pass("fewer than 3 photos have no mean to be far from"),
        }
    }
}
