//! A stage that requests its children in rounds. Those of a round read the outputs of the round before.

use std::{
    collections::BTreeMap,
    sync::{Arc, atomic::Ordering},
};

use marf_stage::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::fixture::{FixtureId, fixture};

/// Draws from sums, then from half of the draws with the largest texts, and so on.
pub struct Knockout(KnockoutParams);

#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct KnockoutParams {
    pub fixture: FixtureId,
    /// Children of the first round.
    pub first: u64,
    pub rounds: u64,
    /// The round whose first child fails.
    pub unlucky: u64,
    pub how: How,
}

/// How a further round is chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum How {
    /// By the texts drawn, the largest first.
    ByText,
    /// The first half, whatever was drawn: no output is read.
    Unread,
    /// As `ByText`, under the names of the first round.
    Repeated,
}

impl Stage for Knockout {
    fn params(&self) -> serde_json::Value {
        key_params(&self.0, &["fixture"])
    }

    fn work(&self) -> Work<'_> {
        Work::Expand(self)
    }
}

impl Define for Knockout {
    type Params = KnockoutParams;
    const NAME: &'static str = "knockout";
    const ABOUT: &'static str = "a stage of a test";
    const VERSION: u32 = 1;
    const PORTS: &'static [Port] = &[Port::required("input", "sum")];
    const OUTPUTS: &'static [&'static str] = &["all"];

    fn new(params: KnockoutParams) -> Result<Self, ParamError> {
        Ok(Self(params))
    }
}

impl Knockout {
    /// Returns the number of the round after this many children, and where the last one began.
    fn round_after(&self, done: usize) -> (u64, usize) {
        let (mut round, mut begin, mut size) = (0, 0, self.0.first as usize);
        while begin + size < done {
            (round, begin, size) = (round + 1, begin + size, size.div_ceil(2));
        }
        (round + 1, begin)
    }

    fn child(&self, round: u64, index: usize, sum: marf_cache::Digest) -> NodeSpec {
        // By name later rounds come first.
        let round_name = if self.0.how == How::Repeated { 0 } else { round };
        let seed = match (round, index) {
            (round, 0) if round == self.0.unlucky => 1313,
            _ => 10 * round + index as u64,
        };
        NodeSpec {
            name: format!("{}-{index}", 9 - round_name),
            stage: "draw".to_owned(),
            params: serde_json::json!({ "fixture": self.0.fixture.0, "seed": seed }),
            inputs: Inputs(BTreeMap::from([("sum".to_owned(), sum)])),
        }
    }
}

impl Expand for Knockout {
    fn children(&self) -> Vec<ChildStage> {
        vec![ChildStage {
            stage: "draw",
            params: serde_json::json!({ "fixture": self.0.fixture.0, "seed": 0 }),
        }]
    }

    fn expand(&self, _ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<NodeSpec>, StageError> {
        let sum = *inputs.required("sum")?;
        let first = 0..self.0.first as usize;
        Ok(first.map(|index| self.child(0, index, sum)).collect())
    }

    fn further(
        &self,
        ctx: &Ctx<'_>,
        _inputs: &Inputs,
        done: &[Outputs],
    ) -> Result<Vec<NodeSpec>, StageError> {
        let (round, begin) = self.round_after(done.len());
        let last = &done[begin..];
        if round >= self.0.rounds || last.len() < 2 {
            return Ok(Vec::new());
        }
        let mut drawn = Vec::new();
        for outputs in last {
            let text = match self.0.how {
                How::Unread => Arc::default(),
                How::ByText | How::Repeated => ctx.get(&outputs["draw"])?,
            };
            drawn.push((text, outputs["draw"]));
        }
        drawn.sort_by(|a, b| b.0.cmp(&a.0));
        drawn.truncate(last.len().div_ceil(2));
        let next = drawn.iter().enumerate();
        Ok(next
            .map(|(index, (_, draw))| self.child(round, index, *draw))
            .collect())
    }

    fn reduce(&self, ctx: &Ctx<'_>, _inputs: &Inputs, children: &[Outputs]) -> Result<Outputs, StageError> {
        fixture(self.0.fixture.0).reduced.fetch_add(1, Ordering::Relaxed);
        let mut all = Vec::new();
        for child in children {
            all.extend_from_slice(&ctx.get(&child["draw"])?);
            all.push(b'\n');
        }
        Ok(BTreeMap::from([("all".to_owned(), ctx.put(&all)?)]))
    }
}
