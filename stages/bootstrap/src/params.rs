use marf_cache::ContentHash;
use marf_field::{Device, Overrides, Quality};
use marf_stage::{
    Ctx, Define, Expand, Inputs, NodeSpec, Outputs, ParamError, Port, Stage, StageError, Threads, Work,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::reduce::reduce;

/// What differs between members.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, ContentHash)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// The seed: first weights and order of rays, as in the paper.
    #[default]
    Seeds,
    /// The seed and the photos, drawn anew with replacement: a bootstrap in the sense of statistics.
    Photos,
}

/// Where maps are made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, ContentHash)]
#[serde(rename_all = "snake_case")]
pub enum Viewpoints {
    /// At the photos held out, where the truth is known.
    #[default]
    Heldout,
    /// Along the fly-through.
    Flythrough,
    /// Around the point the cameras look at.
    Orbit,
}

/// What the fly-through shows beside the mean colour.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, ContentHash)]
#[serde(rename_all = "snake_case")]
pub enum Shown {
    /// Sample standard deviation of gray.
    #[default]
    Std,
    /// With the opacity term: what no photo saw stands out, and so does a learnt sky.
    Total,
}

/// Parameters of `bootstrap`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, ContentHash)]
#[serde(default, deny_unknown_fields)]
pub struct BootstrapParams {
    /// Retrainings, at least 2. Five rank pixels well; intervals want ten.
    pub b: u32,
    /// What differs between members.
    pub mode: Mode,
    /// Seed of the first member; each further one adds 1.
    pub seed: u64,
    /// Steps, size of the photos and size of the field, as for `train`.
    pub quality: Quality,
    /// Optimiser steps of a member, instead of those of `quality`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<u64>,
    /// Whole factor by which photos are shrunk; absent: as for `train`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<u32>,
    /// Keys of the field; they win over those of the input `params`.
    pub field: Overrides,
    /// Where maps are made.
    pub viewpoints: Viewpoints,
    /// Number of viewpoints, where they are not photos.
    pub map_frames: u32,
    /// Pictures of the fly-through, at least 1.
    pub frames: u32,
    /// Width of a picture of the fly-through, pixels.
    pub width: u32,
    /// Pictures a second of the animation.
    pub fps: u32,
    /// What the fly-through shows beside the mean colour.
    pub show: Shown,
    /// Which processor trains and renders: `auto` (a GPU where there is one, never a software adapter), `cpu`, `gpu`,
    /// or `gpu:NAME` for the adapter whose name holds NAME. Only what was opened is in the key.
    #[content_hash(skip)]
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
            viewpoints: Viewpoints::Heldout,
            map_frames: 6,
            frames: 30,
            width: 240,
            fps: 10,
            show: Shown::Std,
            device: Device::default(),
        }
    }
}

/// Most members; beyond it a number is a slip.
const MAX_MEMBERS: u32 = 1000;
/// Largest picture and longest animation.
const MAX_WIDTH_PX: u32 = 4096;
const MAX_FRAMES: u32 = 10_000;

/// Trains B fields that differ in seed or photos, and maps where they disagree.
#[derive(Debug)]
pub struct Bootstrap {
    params: BootstrapParams,
}

impl Define for Bootstrap {
    type Params = BootstrapParams;
    const NAME: &'static str = "bootstrap";
    const ABOUT: &'static str = "Retrains B times and maps where the fields disagree";
    const VERSION: u32 = 3;
    const PORTS: &'static [Port] = &[
        Port::required("input", "scene"),
        Port::optional("params", "params"),
    ];
    const OUTPUTS: &'static [&'static str] = &["metrics", "video", "maps/", "flythrough/"];

    fn new(params: BootstrapParams) -> Result<Self, ParamError> {
        check(&params)?;
        Ok(Self { params })
    }
}

fn check(params: &BootstrapParams) -> Result<(), ParamError> {
    if params.b < 2 {
        let message = format!(
            "{} member has no spread: at least 2, 5 for maps, 10 for intervals",
            params.b
        );
        return Err(ParamError::new("b", message));
    }
    let at_most = |key: &str, value: u32, most: u32| {
        let message = || format!("{value} is more than {most}");
        if value > most {
            Err(ParamError::new(key, message()))
        } else {
            Ok(())
        }
    };
    let above_zero = |key: &str, value: u64| match value {
        0 => Err(ParamError::new(key, "0 gives nothing; at least 1")),
        _ => Ok(()),
    };
    at_most("b", params.b, MAX_MEMBERS)?;
    at_most("frames", params.frames, MAX_FRAMES)?;
    at_most("map_frames", params.map_frames, MAX_FRAMES)?;
    at_most("width", params.width, MAX_WIDTH_PX)?;
    at_most("fps", params.fps, 100)?;
    above_zero("frames", u64::from(params.frames))?;
    above_zero("width", u64::from(params.width))?;
    above_zero("fps", u64::from(params.fps))?;
    above_zero("map_frames", u64::from(params.map_frames))?;
    above_zero("steps", params.steps.unwrap_or(1))?;
    above_zero("scale", u64::from(params.scale.unwrap_or(1)))?;
    let field = params.field.over(&params.quality.config());
    field.map(|_| ()).map_err(|error| {
        let path = format!("field.{}", error.key);
        ParamError::new(path.trim_end_matches('.'), error.message)
    })
}

impl Stage for Bootstrap {
    fn params(&self) -> &dyn ContentHash {
        &self.params
    }

    fn work(&self) -> Work<'_> {
        Work::Expand(self)
    }

    fn threads(&self) -> Threads {
        Threads::All
    }

    fn backend_id(&self) -> Option<String> {
        self.params.device.class()
    }
}

impl Expand for Bootstrap {
    fn expand(&self, _ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<NodeSpec>, StageError> {
        Ok((0..self.params.b)
            .map(|index| member(&self.params, index, inputs))
            .collect())
    }

    fn reduce(&self, ctx: &Ctx<'_>, inputs: &Inputs, children: &[Outputs]) -> Result<Outputs, StageError> {
        reduce(ctx, &self.params, inputs, children)
    }
}

/// Member `index`: its seed, and in mode `photos` its draw of photos, is `seed + index`, round the end of u64.
fn member(params: &BootstrapParams, index: u32, inputs: &Inputs) -> NodeSpec {
    let seed = params.seed.wrapping_add(u64::from(index));
    // Members differ by their seed or photos alone: none tries parts of its own.
    let trials = json!({ "steps": 0 });
    let mut table =
        json!({ "quality": params.quality, "seed": seed, "field": params.field, "trials": trials });
    if params.device != Device::default() {
        table["device"] = json!(params.device);
    }
    if let Some(steps) = params.steps {
        table["steps"] = json!(steps);
    }
    if let Some(scale) = params.scale {
        table["scale"] = json!(scale);
    }
    if params.mode == Mode::Photos {
        table["resample"] = json!(seed);
    }
    NodeSpec {
        name: format!("member-{index:02}"),
        stage: "train".to_owned(),
        params: table,
        inputs: inputs.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_stage::harness::Harness;

    fn asked(table: serde_json::Value) -> Vec<NodeSpec> {
        let params = serde_json::from_value(table).unwrap();
        let harness = Harness::default();
        let stage = Bootstrap::new(params).unwrap();
        stage.expand(&harness.ctx(), &Inputs::default()).unwrap()
    }

    #[test]
    fn more_members_keep_the_first_ones() {
        let (three, five) = (asked(json!({"b": 3})), asked(json!({"b": 5})));
        assert_eq!(three, five[..3]);
        assert_eq!(five[4].name, "member-04");
        assert_eq!(five[4].params["seed"], 4);
    }

    #[test]
    fn seeds_of_64_bits_stay_whole_and_wrap() {
        let seed = u64::MAX - 1;
        let members = asked(json!({"b": 3, "seed": seed, "mode": "photos"}));
        let seeds: Vec<u64> = members
            .iter()
            .filter_map(|node| node.params["seed"].as_u64())
            .collect();
        assert_eq!(seeds, [seed, u64::MAX, 0]);
        assert_eq!(members[1].params["resample"], json!(u64::MAX));
        assert_eq!(asked(json!({}))[0].params.get("resample"), None);
    }

    #[test]
    fn one_member_and_other_slips_are_refused_by_key() {
        for (table, key) in [
            (json!({"b": 1}), "b"),
            (json!({"b": 0}), "b"),
            (json!({"b": 1001}), "b"),
            (json!({"frames": 0}), "frames"),
            (json!({"width": 0}), "width"),
            (json!({"fps": 0}), "fps"),
            (json!({"steps": 0}), "steps"),
            (json!({"scale": 0}), "scale"),
            (json!({"field": {"levls": 8}}), "field.levls"),
        ] {
            let params = serde_json::from_value(table).unwrap();
            let error = Bootstrap::new(params).unwrap_err();
            assert_eq!(error.path, key, "{error:?}");
        }
    }
}
