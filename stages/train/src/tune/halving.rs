//! Successive halving: all trials begin, the best go on, and the last rung is the whole training.
//!
//! A rung is derived from the outputs of the nodes before it, so nothing is remembered between two rounds.

use std::collections::BTreeMap;

use marf_cache::Digest;
use marf_schema::{
    output::STATE,
    partial::{PartialParams, Reached, STEPS_AT_ONCE},
    train::Metrics,
    tune::TuneParams,
};
use marf_stage::{Ctx, Inputs, NodeSpec, Outputs, StageError};

use super::{
    judged::{Standing, TrialScore, miscounted},
    sampling::sample_params,
    trainings::{scatter, train_of},
};
use crate::child::Child;

/// The trials of one rung.
struct Rung {
    /// Its number, from 1.
    number: usize,
    /// Steps after which its trials stop.
    until: u64,
    is_last: bool,
    /// Numbers of the trials, rising.
    trials: Vec<u32>,
}

/// What the nodes so far have given.
struct Climb {
    /// How each trial was judged last, by its number.
    judged: BTreeMap<u32, TrialScore>,
    /// The state in which each trial was stopped last.
    states: BTreeMap<u32, Digest>,
    /// The defaults with another seed.
    other_seed: Option<TrialScore>,
    /// The rung whose nodes have not been requested yet.
    next: Option<Rung>,
    /// What came behind the last rung.
    rest: Vec<Outputs>,
}

/// Returns the steps after which trials are compared: H/eta², H/eta and H, taken up to multiples of 16, each once.
pub(super) fn rungs(horizon: u64, eta: u32) -> Vec<u64> {
    let eta = u64::from(eta);
    let share = |parts: u64| {
        (horizon / parts)
            .max(1)
            .next_multiple_of(STEPS_AT_ONCE)
            .min(horizon)
    };
    let mut rungs = vec![share(eta * eta), share(eta), horizon];
    rungs.dedup();
    rungs
}

/// Returns the nodes of the next rung, or none after the last. The last rung also has the defaults with another seed.
pub(super) fn next_rung(
    ctx: &Ctx<'_>,
    params: &TuneParams,
    inputs: &Inputs,
    done: &[Outputs],
) -> Result<Vec<NodeSpec>, StageError> {
    let climb = Climb::read(ctx, params, done)?;
    let Some(rung) = &climb.next else {
        return Ok(Vec::new());
    };
    let mut nodes = Vec::with_capacity(rung.trials.len() + 1);
    for &trial in &rung.trials {
        let set = sample_params(&params.space, params.seed, trial);
        let train = train_of(params, params.seed, &set);
        let mut inputs = inputs.clone();
        let state = climb.states.get(&trial);
        inputs.0.extend(state.map(|state| (STATE.to_owned(), *state)));
        nodes.push(if rung.is_last {
            NodeSpec::new(format!("trial-{trial:02}"), &train, &inputs)?
        } else {
            let name = format!("rung-{}-trial-{trial:02}", rung.number);
            NodeSpec::new(name, &PartialParams::new(train, rung.until), &inputs)?
        });
    }
    if rung.is_last {
        nodes.push(scatter(params, 0, inputs)?);
    }
    Ok(nodes)
}

/// Returns how all trials came out.
///
/// # Errors
/// Nodes other than the planned ones, or an output that cannot be read.
pub(super) fn standing(ctx: &Ctx<'_>, params: &TuneParams, done: &[Outputs]) -> Result<Standing, StageError> {
    let climb = Climb::read(ctx, params, done)?;
    let other_seed = climb.other_seed.ok_or_else(|| miscounted(params, done.len()))?;
    let judged = climb.judged.into_values().collect();
    Standing::new(ctx, params, judged, other_seed, &climb.rest)
}

impl Climb {
    fn read(ctx: &Ctx<'_>, params: &TuneParams, done: &[Outputs]) -> Result<Self, StageError> {
        let mut climb = Self {
            judged: BTreeMap::new(),
            states: BTreeMap::new(),
            other_seed: None,
            next: None,
            rest: Vec::new(),
        };
        let rungs = rungs(params.horizon(), params.eta);
        let (mut trials, mut rest): (Vec<u32>, _) = ((0..params.trials).collect(), done);
        let mut keeps = params.trials;
        for (index, &until) in rungs.iter().enumerate() {
            let rung = Rung {
                number: index + 1,
                until,
                is_last: index + 1 == rungs.len(),
                trials,
            };
            if rest.is_empty() {
                climb.next = Some(rung);
                return Ok(climb);
            }
            let count = rung.trials.len() + usize::from(rung.is_last);
            let (these, after) = rest
                .split_at_checked(count)
                .ok_or_else(|| miscounted(params, done.len()))?;
            climb.add(ctx, &rung, these)?;
            keeps = keeps.div_ceil(params.eta);
            trials = climb.best(&rung, keeps as usize);
            rest = after;
        }
        climb.rest = rest.to_vec();
        Ok(climb)
    }

    /// Adds what the nodes of a rung gave.
    fn add(&mut self, ctx: &Ctx<'_>, rung: &Rung, outputs: &[Outputs]) -> Result<(), StageError> {
        for (&trial, outputs) in rung.trials.iter().zip(outputs) {
            let name = format!("trial {trial:02}");
            let child = Child { name, outputs };
            let judged = if rung.is_last {
                child.read::<Metrics>(ctx)?.into()
            } else {
                self.states.insert(trial, *child.digest(STATE)?);
                child.read::<Reached>(ctx)?.into()
            };
            self.judged.insert(trial, judged);
        }
        if let (true, Some(outputs)) = (rung.is_last, outputs.get(rung.trials.len())) {
            let name = "the scatter".to_owned();
            self.other_seed = Some(Child { name, outputs }.read::<Metrics>(ctx)?.into());
        }
        Ok(())
    }

    /// Returns the `count` trials of a rung with the best PSNR, and the defaults in any case. Of equals the first is taken.
    fn best(&self, rung: &Rung, count: usize) -> Vec<u32> {
        let psnr = |trial: &u32| self.judged.get(trial).map_or(f64::MIN, |judged| judged.psnr);
        let mut best = rung.trials.clone();
        best.sort_by(|a, b| psnr(b).total_cmp(&psnr(a)).then(a.cmp(b)));
        best.truncate(count);
        if !best.contains(&0) {
            best.push(0);
        }
        best.sort_unstable();
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Tune;
    use marf_schema::example;
    use marf_stage::{Define, Expand, TypedOutputs, harness::Harness};
    use serde_json::json;

    #[test]
    fn rungs_are_shares_of_the_whole_in_multiples_of_16() {
        assert_eq!(rungs(400, 3), [48, 144, 400]);
        assert_eq!(rungs(4_000, 3), [448, 1_344, 4_000]);
        assert_eq!(rungs(20, 3), [16, 20]);
        for (horizon, eta) in [(1, 3), (16, 2), (3, 10)] {
            assert_eq!(rungs(horizon, eta), [horizon]);
        }
        assert_eq!(rungs(u64::MAX, 2)[2], u64::MAX);
    }

    /// A search whose trials have these PSNRs in each rung.
    struct Search {
        harness: Harness,
        tune: Tune,
        inputs: Inputs,
        done: Vec<Outputs>,
    }

    impl Search {
        fn new(table: serde_json::Value) -> Self {
            let harness = Harness::default();
            let inputs = Inputs([("scene".to_owned(), harness.put(b"scene"))].into());
            Self {
                tune: Tune::new(serde_json::from_value(table).unwrap()).unwrap(),
                harness,
                inputs,
                done: Vec::new(),
            }
        }

        /// Requests the next rung, gives each of its nodes the PSNR of its trial and returns the nodes.
        fn climb(&mut self, psnr: &dyn Fn(u32) -> f64) -> Vec<NodeSpec> {
            let ctx = self.harness.ctx();
            let nodes = if self.done.is_empty() {
                self.tune.expand(&ctx, &self.inputs).unwrap()
            } else {
                self.tune.further(&ctx, &self.inputs, &self.done).unwrap()
            };
            for node in &nodes {
                let trial = node.name.rsplit('-').next().unwrap().parse().unwrap();
                let mut outputs = Outputs::new();
                match node.stage.as_str() {
                    "partial" => {
                        let until = node.params["until"].as_u64().unwrap();
                        let state = format!("trial {trial} at {until}");
                        outputs.put_bytes(&ctx, STATE, state.as_bytes()).unwrap();
                        let reached = Reached {
                            until,
                            steps: 400,
                            psnr: psnr(trial),
                            held_out_photos: 1,
                            judged_px: 128,
                        };
                        outputs.put(&ctx, &reached).unwrap();
                    }
                    _ => {
                        let mut metrics = example::train_metrics();
                        metrics.scores.psnr = psnr(trial);
                        outputs.put(&ctx, &metrics).unwrap();
                    }
                }
                self.done.push(outputs);
            }
            nodes
        }
    }

    fn names(nodes: &[NodeSpec]) -> Vec<&str> {
        nodes.iter().map(|node| node.name.as_str()).collect()
    }

    #[test]
    fn the_best_third_goes_on_from_its_states_and_the_defaults_always() {
        let mut search = Search::new(json!({"scale": 1}));
        let first = search.climb(&|trial| 10.0 + f64::from(trial));
        assert_eq!(first.len(), 9);
        assert_eq!(
            (first[3].name.as_str(), &first[3].params["until"]),
            ("rung-1-trial-03", &json!(48))
        );
        assert!(
            first.iter().all(|node| node.inputs == search.inputs),
            "from step 0"
        );
        let second = search.climb(&|trial| 30.0 - f64::from(trial));
        let rung_2 = |trial: u32| format!("rung-2-trial-{trial:02}");
        assert_eq!(names(&second), [0, 6, 7, 8].map(rung_2));
        let state = |node: &NodeSpec| {
            let bytes = search.harness.get(&node.inputs.0["state"]).unwrap();
            String::from_utf8(bytes.to_vec()).unwrap()
        };
        assert_eq!(state(&second[1]), "trial 6 at 48");
        let last = search
            .tune
            .further(&search.harness.ctx(), &search.inputs, &search.done)
            .unwrap();
        // The defaults are the best of the second rung: nobody is left to compare them with.
        assert_eq!(names(&last), ["trial-00", "scatter-00"]);
        assert_eq!(state(&last[0]), "trial 0 at 144");
        assert_eq!(last[1].inputs, search.inputs, "another seed begins at step 0");
        for node in &last {
            assert_eq!(
                (node.stage.as_str(), &node.params["steps"]),
                ("train", &json!(400))
            );
        }
    }

    #[test]
    fn the_winner_is_compared_with_the_defaults_in_the_last_rung() {
        let mut search = Search::new(json!({"scale": 1, "trials": 4}));
        let worst_default = |trial: u32| if trial == 0 { 5.0 } else { 20.0 - f64::from(trial) };
        let sizes: Vec<usize> = (0..4).map(|_| search.climb(&worst_default).len()).collect();
        // Of 4 the best 2 and the defaults, then the best and the defaults with the scatter.
        assert_eq!(sizes, [4, 3, 3, 1]);
        assert_eq!(search.climb(&worst_default), []);
        let standing = standing(&search.harness.ctx(), &search.tune.params, &search.done).unwrap();
        let Standing {
            judged,
            other_seed,
            best_with_other_seed,
        } = standing;
        assert_eq!(best_with_other_seed.unwrap().psnr, 19.0);
        let steps: Vec<u64> = judged.iter().map(|judged| judged.steps).collect();
        assert_eq!(steps, [400, 400, 144, 48]);
        assert_eq!(
            (judged[0].psnr, judged[1].psnr, other_seed.psnr),
            (5.0, 19.0, 5.0)
        );
        assert_eq!((judged[2].judged_px, judged[1].judged_px), (Some(128), None));
    }

    #[test]
    fn only_a_trial_that_is_ahead_is_looked_at_again_and_with_another_seed() {
        for (psnr, again) in [(20.0, vec![]), (20.05, vec![]), (21.0, vec!["scatter-01"])] {
            let mut search = Search::new(json!({"scale": 1, "trials": 2, "seed": 7}));
            // The second trial leads until the last rung, which decides.
            search.climb(&|trial| 10.0 + f64::from(trial));
            search.climb(&|trial| 10.0 + f64::from(trial));
            let last = search.climb(&|trial| if trial == 1 { psnr } else { 20.0 });
            assert_eq!(names(&last), ["trial-00", "trial-01", "scatter-00"]);
            let nodes = search.climb(&|_| 21.0);
            assert_eq!(names(&nodes), again, "{psnr}");
            for node in nodes {
                assert_eq!(node.params["seed"], 8);
                assert_eq!(node.params["field"], last[1].params["field"]);
                assert_eq!(node.inputs, search.inputs, "from step 0");
            }
        }
    }

    #[test]
    fn one_trial_is_the_defaults_and_their_scatter() {
        let mut search = Search::new(json!({"scale": 1, "trials": 1, "steps": 16}));
        assert_eq!(names(&search.climb(&|_| 20.0)), ["trial-00", "scatter-00"]);
        assert_eq!(search.climb(&|_| 20.0), []);
    }

    #[test]
    fn outputs_of_other_nodes_are_refused_with_their_number() {
        let mut search = Search::new(json!({"scale": 1}));
        search.climb(&|_| 20.0);
        search.done.pop();
        let further = search
            .tune
            .further(&search.harness.ctx(), &search.inputs, &search.done);
        assert!(further.unwrap_err().to_string().contains("got 8"));
    }
}
