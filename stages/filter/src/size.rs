//! The filter `size`.

use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::by_hand::ByHand;
use crate::decision::Decision;
use crate::decoded::DecodedPhoto;
use crate::filter::{Filter, MeasuredPhoto, check_range};
#[cfg(test)]
use crate::section::Guard;

/// Rejects photos stored in too few bytes: broken downloads and pictures compressed beyond use.
pub struct Size;

/// Parameters of [`Size`].
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SizeParams {
    /// Smallest size of the image file in the archive, bytes. The paper uses 100,000 for photos of 2
    /// megapixels.
    pub min_bytes: u64,
    /// Fewest stored bits per pixel. 0 turns it off. JPEG at the lowest quality takes 0.15 to 0.17, real photos of
    /// Perseverance take 0.7 and more.
    pub min_bits_per_pixel: f64,
    /// Photos kept or rejected by hand, filled from `[keep]` and `[reject]` of the pipeline.
    pub by_hand: ByHand,
}

impl Default for SizeParams {
    fn default() -> Self {
        Self {
            min_bytes: 20_000,
            min_bits_per_pixel: 0.25,
            by_hand: ByHand::default(),
        }
    }
}

impl Filter for Size {
    const NAME: &'static str = "size";
    const ABOUT: &'static str = "rejects photos that carry too few bytes";
    const RELAX: &'static str = "a lower `min_bytes` or `min_bits_per_pixel`";
    const MEASURE_VERSION: u32 = 0;
    const DECISION_VERSION: u32 = 2;
    type Params = SizeParams;
    type Measure = ();
    type Context = ();
    /// The size is a fact of the photo.
    const MEASURE: Option<fn(&DecodedPhoto<'_>)> = None;

    #[cfg(test)]
    const GUARD: Guard = Guard {
        measures: "",
        decisions: "2 980ee38a3c37",
    };

    fn by_hand(params: &SizeParams) -> &ByHand {
        &params.by_hand
    }

    fn check(params: &SizeParams) -> Result<(), ParamError> {
        check_range("min_bits_per_pixel", params.min_bits_per_pixel, 0.0, 48.0)
    }

    fn decide(params: &SizeParams, _: Option<&()>, photo: &MeasuredPhoto<'_, ()>) -> Decision {
        let (bytes, least) = (photo.facts.size_bytes, params.min_bytes);
        if bytes < least {
            return Decision::reject(
                bytes as f64,
                least as f64,
                format!("{bytes} bytes, at least {least}"),
            );
        }
        let pixels = u64::from(photo.facts.width) * u64::from(photo.facts.height);
        let bits = (8 * bytes) as f64 / pixels.max(1) as f64;
        if bits < params.min_bits_per_pixel {
            let reason = format!(
                "{bits:.3} bits a pixel ({bytes} bytes), at least {}",
                params.min_bits_per_pixel
            );
            return Decision::reject(bits, params.min_bits_per_pixel, reason);
        }
        Decision::keep(bytes as f64, least as f64)
    }
}
