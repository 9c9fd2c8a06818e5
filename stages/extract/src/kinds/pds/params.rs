//! The keys of `kind = "pds"`.

use schemars::JsonSchema;
use serde::Deserialize;

use crate::kinds::mission::{Instrument, Mission};
use crate::remote::network::Network;
use marf_stage::Sols;

/// The keys of `kind = "pds"`: one camera of one mission.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct PdsParams {
    /// The mission.
    pub mission: Mission,
    /// The camera.
    pub instrument: Instrument,
    /// Sols: `1..=5`, `3`, `1,4,7..=9` or `latest`.
    pub sols: Sols,
    /// Processing level of the products. `edr` is raw.
    #[serde(default)]
    pub level: Level,
    /// Source of the pixels. Labels come from the folder of the `.IMG` either way.
    #[serde(default)]
    pub pixels: PixelSource,
    /// Product types, the preferred first. marf fetches the first type that an exposure has. Default: the
    /// usual types of the camera.
    #[serde(default)]
    pub products: Vec<String>,
    /// Addresses of the archive, tried in this order: folders that contain `mars2020/` and `msl/`.
    #[serde(default)]
    pub base: Vec<String>,
    /// How the network is used.
    #[serde(default)]
    pub network: Network,
}

/// Processing level of products.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Level {
    /// Raw.
    #[default]
    Edr,
    /// Geometry refined (Mars 2020 only).
    Fdr,
    /// Calibrated.
    Rdr,
}

/// Where pixels come from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum PixelSource {
    /// PNG of 8 bits. Mars 2020 only, otherwise the same as `img`.
    #[default]
    Browse,
    /// The `.IMG` as archived, 16 bits and more.
    Img,
}
