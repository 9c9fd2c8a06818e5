//! `bootstrap`: B retrainings to uncertainty maps.

mod metrics;

use marf_field::{Device, Overrides, Quality};
use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

use crate::{
    check::{check_field, check_scale, check_steps, check_within},
    train::Fit,
};

pub use metrics::{
    Calibration, Coverage, HeldOut, Member, MemberFields, Metrics, OutOfBag, PhotoReport,
    SparsificationCurves, ViewReport,
};

/// What differs between members.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// The seed: first weights and order of rays, as in the paper.
    #[default]
    Seeds,
    /// The seed and the photos, which are drawn with replacement: a bootstrap in the sense of statistics.
    Photos,
}

/// Where maps are made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Viewpoints {
    /// At the photos held out, where the truth is known.
    #[default]
    Heldout,
    /// At the photos trained on: at all of them, as in the paper.
    Train,
    /// Along a smooth path through training cameras.
    Flythrough,
    /// Around the point the cameras look at.
    Orbit,
}

/// One kind of viewpoints or several: `"heldout"`, `["heldout", "orbit"]`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(from = "OneOrMore", into = "OneOrMore")]
#[schemars(with = "OneOrMore")]
pub struct ViewpointList(pub Vec<Viewpoints>);

/// As it is written.
#[derive(Debug, Clone, Serialize, JsonSchema)]
#[serde(untagged)]
enum OneOrMore {
    One(Viewpoints),
    More(Vec<Viewpoints>),
}

/// Unlike that of serde, which keeps no error of a variant, it names the word that is not known.
impl<'de> Deserialize<'de> for OneOrMore {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let written = serde_json::Value::deserialize(deserializer)?;
        let read = if written.is_array() {
            serde_json::from_value(written).map(Self::More)
        } else {
            serde_json::from_value(written).map(Self::One)
        };
        read.map_err(serde::de::Error::custom)
    }
}

impl From<OneOrMore> for ViewpointList {
    fn from(written: OneOrMore) -> Self {
        Self(match written {
            OneOrMore::One(one) => vec![one],
            OneOrMore::More(list) => list,
        })
    }
}

impl From<ViewpointList> for OneOrMore {
    fn from(ViewpointList(list): ViewpointList) -> Self {
        match list.as_slice() {
            [one] => Self::One(*one),
            _ => Self::More(list),
        }
    }
}

impl Default for ViewpointList {
    fn default() -> Self {
        Self(vec![Viewpoints::default()])
    }
}

/// Parameters of `bootstrap`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BootstrapParams {
    /// Retrainings: at least 2. Ranking pixels well takes five, intervals take ten. Going from 5 to 7 trains two more.
    pub b: u32,
    /// What differs between members.
    pub mode: Mode,
    /// Seed of the first member. Each further member adds 1. With the seed of `training` the first member
    /// repeats that training.
    pub seed: u64,
    /// Steps, size of the photos and size of the field, as for `train`. `training` decides all four keys from
    /// here to `field`.
    pub quality: Quality,
    /// Optimiser steps of a member, instead of those of `quality`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<u64>,
    /// Whole factor by which photos are shrunk. Default: as for `train`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<u32>,
    /// Keys of the field. They override those of the input `params`.
    pub field: Overrides,
    /// Where maps are made: `heldout`, `train`, `flythrough`, `orbit`, or a list of these.
    pub viewpoints: ViewpointList,
    /// Number of viewpoints of `flythrough` and `orbit`.
    pub map_frames: u32,
    /// Device that trains and renders: `auto` (a GPU if there is one, never a software adapter), `cpu`,
    /// `gpu`, or `gpu:NAME` for the adapter whose name contains NAME. Only the device that is used is part
    /// of the key.
    pub device: Device,
}

impl Default for BootstrapParams {
    fn default() -> Self {
        Self {
            b: 5,
            mode: Mode::Seeds,
            seed: 0,
            quality: Quality::default(),
            steps: None,
            scale: None,
            field: Overrides::default(),
            viewpoints: ViewpointList::default(),
            map_frames: 6,
            device: Device::default(),
        }
    }
}

/// Most members. A larger number is taken for a mistake.
const MAX_MEMBERS: u32 = 1000;
/// Most viewpoints along a path.
const MAX_FRAMES: u32 = 10_000;

impl BootstrapParams {
    /// Checks what can be checked without a scene.
    ///
    /// # Errors
    /// Names the key that is out of range.
    pub fn check(&self) -> Result<(), ParamError> {
        if self.b < 2 {
            let count = self.b;
            let message = format!("{count} member has no spread: at least 2, 5 for maps, 10 for intervals");
            return Err(ParamError::new("b", message));
        }
        check_within("b", self.b, 2..=MAX_MEMBERS)?;
        check_within("map_frames", self.map_frames, 1..=MAX_FRAMES)?;
        let ViewpointList(viewpoints) = &self.viewpoints;
        for (index, kind) in viewpoints.iter().enumerate() {
            if viewpoints[..index].contains(kind) {
                return Err(ParamError::new("viewpoints", "a kind is listed twice"));
            }
        }
        if viewpoints.is_empty() {
            return Err(ParamError::new(
                "viewpoints",
                "the list is empty: name at least one kind",
            ));
        }
        check_steps(self.steps)?;
        check_scale(self.scale)?;
        check_field(&Fit::Scene.config(), &self.field)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn one_member_and_other_slips_are_refused_by_key() {
        for (table, key) in [
            (json!({"b": 1}), "b"),
            (json!({"b": 0}), "b"),
            (json!({"b": 1001}), "b"),
            (json!({"map_frames": 0}), "map_frames"),
            (json!({"steps": 0}), "steps"),
            (json!({"scale": 0}), "scale"),
            (json!({"viewpoints": []}), "viewpoints"),
            (json!({"viewpoints": ["orbit", "orbit"]}), "viewpoints"),
            (json!({"field": {"levls": 8}}), "field.levls"),
        ] {
            let params: BootstrapParams = serde_json::from_value(table).unwrap();
            let error = params.check().unwrap_err();
            assert_eq!(error.path, key, "{error:?}");
        }
    }

    #[test]
    fn one_kind_of_viewpoints_is_written_as_one() {
        for written in [json!("orbit"), json!(["heldout", "train"])] {
            let params: BootstrapParams = serde_json::from_value(json!({"viewpoints": written})).unwrap();
            assert_eq!(serde_json::to_value(&params.viewpoints).unwrap(), written);
        }
        let one: BootstrapParams = serde_json::from_value(json!({"viewpoints": ["orbit"]})).unwrap();
        assert_eq!(serde_json::to_value(&one.viewpoints).unwrap(), json!("orbit"));
    }
}
