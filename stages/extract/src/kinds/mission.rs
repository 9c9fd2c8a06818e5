//! Missions and cameras, as the archives on servers name them.

use schemars::JsonSchema;
use serde::Deserialize;

/// A mission.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Mission {
    /// The rover of Mars 2020.
    Perseverance,
    /// The helicopter of Mars 2020.
    Ingenuity,
    /// The rover of the Mars Science Laboratory.
    Curiosity,
}

/// A camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Instrument {
    /// The pair of zoom cameras of Perseverance.
    MastcamZ,
    /// The pair of navigation cameras of either rover.
    Navcam,
    /// Both cameras of the helicopter.
    Helicam,
    /// The pair of mast cameras of Curiosity.
    Mastcam,
}
