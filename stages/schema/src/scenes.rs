//! `scenes`: the photos of a mission split by place.

use std::collections::BTreeMap;

use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How photos are split by place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ScenesParams {
    /// How photos are assigned to places: `label` (site, drive and position), `overlap` (what the photos
    /// show) or `auto` (labels, and photos without one go with those that show the same).
    pub by: By,
    /// Fewest photos of a scene. Smaller groups are named and left out.
    pub min_photos: u32,
    /// Most photos of a scene: a place with more is split.
    pub max_photos: u32,
    /// Largest distance of two cameras of a scene, metres, if labels give it.
    pub max_span_m: f64,
    /// Groups made by hand, by name. They come before all others, and have no limits but `min_photos`.
    pub groups: BTreeMap<String, HandMade>,
}

/// How photos are assigned to places.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum By {
    /// Labels, and for photos without one what they show.
    Auto,
    /// Labels alone.
    Label,
    /// What the photos show, whatever labels say.
    Overlap,
}

/// The photos of a group made by hand: those of all these sols, and these.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct HandMade {
    /// Sols.
    pub sols: Vec<u32>,
    /// Product ids or file names.
    pub ids: Vec<String>,
}

impl Default for ScenesParams {
    fn default() -> Self {
        Self {
            by: By::Auto,
            min_photos: 6,
            max_photos: 400,
            max_span_m: 30.0,
            groups: BTreeMap::new(),
        }
    }
}

impl ScenesParams {
    /// Checks what a type cannot.
    ///
    /// # Errors
    /// Names the key: fewer than two photos, limits that no scene meets, an empty group, or a name that is
    /// not allowed for nodes and folders.
    pub fn check(&self) -> Result<(), ParamError> {
        if self.min_photos < 2 {
            let message = format!("{} photos do not make a scene: use at least 2", self.min_photos);
            return Err(ParamError::new("min_photos", message));
        }
        if self.max_photos < self.min_photos {
            let message = format!(
                "{} is less than `min_photos`, {}",
                self.max_photos, self.min_photos
            );
            return Err(ParamError::new("max_photos", message));
        }
        if !(self.max_span_m > 0.0 && self.max_span_m.is_finite()) {
            return Err(ParamError::new(
                "max_span_m",
                "a finite distance above 0 is needed",
            ));
        }
        for (name, group) in &self.groups {
            let path = format!("groups.{name}");
            if !is_name(name) {
                let message = "letters, digits, `-` and `_` make the name of a scene";
                return Err(ParamError::new(path, message));
            }
            if group == &HandMade::default() {
                return Err(ParamError::new(
                    path,
                    "neither `sols` nor `ids`: no photo is meant",
                ));
            }
        }
        Ok(())
    }
}

/// Returns true if a text can be the name of a scene.
pub fn is_name(text: &str) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    !text.is_empty() && text.len() <= 64 && text.chars().all(allowed)
}

/// Output `scenes` of `scenes`: the photos of each place.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Scenes {
    /// The scenes, sorted by name. The photos of each are the output `photos/NAME`.
    pub scenes: Vec<PhotoGroup>,
    /// Groups that do not become scenes, with the reason, sorted by name.
    pub skipped: Vec<PhotoGroup>,
    /// Stops of the rover, by site and drive.
    pub stops: Vec<Stop>,
}

/// Photos of one place.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PhotoGroup {
    /// Its name.
    pub name: String,
    /// What formed the scene, or why it is not a scene, in a sentence.
    pub reason: String,
    /// Ids of its photos, sorted.
    pub photos: Vec<String>,
    /// Their sols, sorted.
    pub sols: Vec<u32>,
    /// Largest distance of two of its cameras by their labels, metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub span_m: Option<f64>,
}

/// A position from which the rover took photos.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stop {
    /// First number of the rover motion counter: positions of one site share a frame.
    pub site: i64,
    /// Second number of it. `None` if a label lacks it.
    pub drive: Option<i64>,
    /// Mean of the cameras in the site's frame, metres: north, east.
    pub position_m: [f64; 2],
    /// Photos taken there.
    pub photos: u64,
    /// The scenes that they are of, sorted.
    pub scenes: Vec<String>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_and_names_that_no_scene_can_have_are_refused_by_key() {
        let refused = |change: &dyn Fn(&mut ScenesParams)| {
            let mut params = ScenesParams::default();
            change(&mut params);
            params.check().unwrap_err().path
        };
        assert_eq!(ScenesParams::default().check(), Ok(()));
        assert_eq!(refused(&|params| params.min_photos = 1), "min_photos");
        assert_eq!(refused(&|params| params.max_photos = 5), "max_photos");
        for span in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(refused(&|params| params.max_span_m = span), "max_span_m");
        }
        let group = |name: &str, group: HandMade| {
            let name = name.to_owned();
            refused(&move |params| drop(params.groups.insert(name.clone(), group.clone())))
        };
        let sols = HandMade {
            sols: vec![3],
            ids: Vec::new(),
        };
        assert_eq!(group("a/b", sols.clone()), "groups.a/b");
        assert_eq!(group("", sols), "groups.");
        assert_eq!(group("delta", HandMade::default()), "groups.delta");
    }
}
