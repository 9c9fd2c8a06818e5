use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How much time a training may take for its quality: points on the measured fronts of both
/// (`benches/front`).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Quality {
    /// To check cameras and photos.
    #[default]
    Draft,
    /// For most work.
    Standard,
    /// For final results.
    Best,
}

impl Quality {
    /// Longest side of a photo that is worth training on at any of them, pixels: on larger ones the same steps learn less, of details of
    /// larger photos, too (`benches/time.md`).
    pub const LONGEST_SIDE_PX: u32 = 480;

    /// Returns the optimiser steps.
    pub const fn steps(self) -> u64 {
        match self {
            Self::Draft => 400,
            Self::Standard => 4_000,
            Self::Best => 20_000,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_step_up_costs_more() {
        let ladder = [Quality::Draft, Quality::Standard, Quality::Best];
        for pair in ladder.windows(2) {
            assert!(pair[0].steps() < pair[1].steps());
        }
    }
}
