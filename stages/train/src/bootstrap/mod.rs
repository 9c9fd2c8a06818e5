//! Bootstrap (`bootstrap`): maps where B retrainings disagree. Every member is a `train` node.
//!
//! Members are sorted pixel by pixel before they are summed, so no map depends on their order.

mod drawing;
mod intervals;
mod mapper;
pub(crate) mod maps;
mod normality;
mod npy;
mod out_of_bag;
mod reach;
mod reduce;
mod report;
mod retrainings;
mod sparsification;
mod study;
mod viewpoints;
mod visibility;

use marf_cache::Digest;
use marf_schema::{
    bootstrap::{BootstrapParams, MemberFields, Metrics, Mode},
    output::{MAPS, SCENE, WEIGHTS},
    train::{Setup, TrainParams},
    tune::BestParams,
};
use marf_stage::{
    ChildStage, Ctx, Document, Expand, Inputs, NodeSpec, Outputs, Port, StageError, Threads, stage,
};

use crate::{checkpoint::identity, io::read_setup};
use reduce::reduce;

/// Trains B fields that differ in seed or photos, and maps where they disagree.
///
/// With `training`, a `train` node, members are that training with other seeds or photos. They take its steps, image scale, box, sizes and
/// configuration, however it found them. Without `training`, members are planned by `quality` and related parameters.
#[derive(Debug)]
pub struct Bootstrap {
    params: BootstrapParams,
}

stage! {
    Bootstrap { params: BootstrapParams },
    Expand,
    Threads::All,
    about: "retrains B times and maps where the fields disagree",
    version: 18,
    ports: [
        Port::required("input", SCENE),
        Port::optional("params", BestParams::OUTPUT),
        Port::optional("training", Setup::OUTPUT).deciding(&["params", "quality", "steps", "scale", "field"]),
    ],
    outputs: [Metrics::OUTPUT, MemberFields::OUTPUT, MAPS],
    device: device,
}

impl Expand for Bootstrap {
    fn children(&self) -> Vec<ChildStage> {
        vec![ChildStage::new(&member(&self.params, 0))]
    }

    fn expand(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<NodeSpec>, StageError> {
        read_setup(ctx, inputs)?;
        let specs = (0..self.params.b).map(|index| {
            let train = member(&self.params, index);
            NodeSpec::new(format!("member-{index:02}"), &train, inputs)
        });
        specs.collect()
    }

    fn reduce(&self, ctx: &Ctx<'_>, inputs: &Inputs, children: &[Outputs]) -> Result<Outputs, StageError> {
        let weights = children.iter().filter_map(|outputs| outputs.get(WEIGHTS));
        let weights: Vec<String> = weights.map(Digest::to_string).collect();
        let identity = identity(self, inputs, &weights.join(" "));
        reduce(ctx, identity, &self.params, inputs, children)
    }
}

/// Returns the training of member `index`: its seed, and in mode `photos` its draw of photos, is `seed + index`,
/// wrapping. With the input `setup` that decides all but seed and draw.
fn member(params: &BootstrapParams, index: u32) -> TrainParams {
    let seed = params.seed.wrapping_add(u64::from(index));
    TrainParams {
        quality: params.quality,
        steps: params.steps,
        seed,
        scale: params.scale,
        resample: (params.mode == Mode::Photos).then_some(seed),
        field: params.field.clone(),
        device: params.device.clone(),
        ..TrainParams::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_stage::Define;
    use marf_stage::harness::Harness;
    use serde_json::json;

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

    /// The keys of members follow from these. Other parameters would retrain the members of every store.
    #[test]
    fn a_member_has_the_parameters_it_always_had() {
        let field = json!({"background": "black"});
        for (table, written) in [
            (json!({"b": 2}), json!({"seed": 1})),
            (
                json!({"b": 2, "seed": 8, "mode": "photos", "steps": 40, "scale": 3, "quality": "best", "field": field,
                    "device": "gpu"}),
                json!({"seed": 9, "resample": 9, "steps": 40, "scale": 3, "quality": "best", "field": field,
                    "device": "gpu"}),
            ),
        ] {
            let written: TrainParams = serde_json::from_value(written).unwrap();
            let node = asked(table).swap_remove(1);
            let bound: TrainParams = serde_json::from_value(node.params).unwrap();
            assert_eq!(bound, written);
        }
    }
}
