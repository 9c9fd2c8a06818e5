//! `ties`: how the scenes of a mission lie to each other.

use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parameters of `ties`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TiesParams {
    /// Most pairs of photos that are compared for two scenes.
    pub pairs: u32,
    /// Fewest common points that must agree on shift, turn and scale between two scenes.
    pub min_points: u32,
    /// Seed of the random samples.
    pub seed: u64,
}

impl Default for TiesParams {
    fn default() -> Self {
        Self {
            pairs: 40,
            min_points: 20,
            seed: 0,
        }
    }
}

impl TiesParams {
    /// Checks what a type cannot.
    ///
    /// # Errors
    /// Names the key: no pairs, or so few points that chance makes them agree.
    pub fn check(&self) -> Result<(), ParamError> {
        if self.pairs == 0 {
            return Err(ParamError::new(
                "pairs",
                "0 pairs of photos tie nothing, at least 1",
            ));
        }
        if self.min_points < 8 {
            let message = format!("{} points agree by chance, at least 8", self.min_points);
            return Err(ParamError::new("min_points", message));
        }
        Ok(())
    }
}

/// Output `ties` of `ties`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Ties {
    /// Every scene with its frame, sorted by name.
    pub scenes: Vec<TiedScene>,
    /// Pairs of scenes that show the same ground, sorted.
    pub ties: Vec<SceneTie>,
    /// Pairs of scenes that were compared and are not tied, sorted, with the reason.
    pub apart: Vec<Apart>,
}

/// Position of a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TiedScene {
    /// Its name.
    pub name: String,
    /// The frame: `site 3`, or `NAME` for the world of the scene of that name.
    pub frame: String,
    /// Reason for that frame.
    pub by: By,
    /// The scenes that tie it to that frame, from the first, which belongs to the frame by itself. Empty for
    /// that one.
    pub through: Vec<String>,
    /// The frame from the scene's world.
    pub frame_from_world: Similarity,
}

/// Reason why a scene belongs to a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum By {
    /// The labels of its photos.
    Labels,
    /// Its photos show parts of a scene in that frame.
    Overlap,
    /// Nothing: the frame is its own.
    Itself,
}

impl By {
    /// The word of reports.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Labels => "labels",
            Self::Overlap => "overlap",
            Self::Itself => "nothing ties it",
        }
    }
}

/// to = scale R from + t.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Similarity {
    /// Scale, positive.
    pub scale: f64,
    /// R, by rows.
    pub rotation: [[f64; 3]; 3],
    /// t.
    pub translation: [f64; 3],
}

/// Two scenes that show the same ground.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneTie {
    /// Their names, sorted.
    pub scenes: [String; 2],
    /// Pairs of photos whose matches are of both.
    pub photo_pairs: u32,
    /// Points of both scenes that these matches join.
    pub points: u32,
    /// Those of them that agree with the tie.
    pub inliers: u32,
    /// Median distance, over these, of where a photo shows a point from where the point of the other scene
    /// falls, in pixels of photos of 1,000.
    pub median_px: f64,
    /// Median distance of the points of each pair, metres. `None` if the first scene has no scale.
    pub median_m: Option<f64>,
    /// The first scene's world from that of the second.
    pub first_from_second: Similarity,
    /// How far labels put them from there. `None` unless both belong to one site by labels.
    pub labels: Option<LabelGap>,
}

/// Gap between the labels and the photos of two scenes in one site.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LabelGap {
    /// Mean of second minus first over the points that agree, metres in the site: north, east, down.
    pub shift_m: [f64; 3],
    /// Angle between both, degrees.
    pub angle_deg: f64,
    /// Metres of the first by labels in one metre of the second.
    pub scale: f64,
}

/// Two scenes that were compared and are not tied.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Apart {
    /// Their names, sorted.
    pub scenes: [String; 2],
    /// Why not, in a sentence.
    pub reason: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_would_tie_by_chance_or_not_at_all_is_refused_by_key() {
        assert_eq!(TiesParams::default().check(), Ok(()));
        let refused = |params: TiesParams| params.check().unwrap_err().path;
        let default = TiesParams::default;
        assert_eq!(
            refused(TiesParams {
                pairs: 0,
                ..default()
            }),
            "pairs"
        );
        assert_eq!(
            refused(TiesParams {
                min_points: 7,
                ..default()
            }),
            "min_points"
        );
    }
}
