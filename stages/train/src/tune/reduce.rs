use marf_schema::tune::{BestParams, Scatter, Trial, Trials, TuneParams};
use marf_stage::{Ctx, Outputs, StageError, TypedOutputs};

use super::{
    judged::{Standing, TrialScore, miscounted},
    sampling::sample_params,
};

/// Ranks the trials, decides between the best and the defaults, and writes the keys of the one that is chosen.
pub(super) fn reduce(ctx: &Ctx<'_>, params: &TuneParams, standing: &Standing) -> Result<Outputs, StageError> {
    let Some(default) = standing.judged.first() else {
        return Err(miscounted(params, 0));
    };
    let scatter = decided(params, standing, default);
    let chosen = sample_params(&params.space, params.seed, scatter.chosen);
    let mut outputs = Outputs::new();
    let field = params.field.with(&chosen);
    outputs.put(ctx, &BestParams { field })?;
    outputs.put(ctx, &Trials(ranked(params, standing)))?;
    outputs.put(ctx, &scatter)?;
    Ok(outputs)
}

/// What the best trial has above the defaults.
struct Gain {
    /// In the mean over the seeds that both were trained with, dB.
    gain_db: f64,
    /// The most that another seed changes, dB.
    difference_db: f64,
}

impl Gain {
    fn new(standing: &Standing, default: &TrialScore) -> Self {
        let (other, best_other) = (&standing.other_seed, standing.best_with_other_seed);
        let best = standing.judged.get(standing.best() as usize).unwrap_or(default);
        let (gain_db, changed_db) = (best.psnr - default.psnr, (default.psnr - other.psnr).abs());
        match best_other {
            None => Self {
                gain_db,
                difference_db: changed_db,
            },
            Some(best_other) => Self {
                gain_db: 0.5 * (gain_db + best_other.psnr - other.psnr),
                difference_db: changed_db.max((best.psnr - best_other.psnr).abs()),
            },
        }
    }
}

/// Returns whether the best trial is ahead of the defaults by more than another seed changes.
pub(super) fn is_ahead(params: &TuneParams, standing: &Standing) -> bool {
    let sure = |default| {
        let gain = Gain::new(standing, default);
        gain.gain_db > gain.difference_db.max(params.least_gain_db)
    };
    standing.best() != 0 && standing.judged.first().is_some_and(sure)
}

/// Decides between the best trial and the defaults, which win unless the gain is more than another seed changes.
fn decided(params: &TuneParams, standing: &Standing, default: &TrialScore) -> Scatter {
    let Gain {
        gain_db,
        difference_db,
    } = Gain::new(standing, default);
    let (best, wins) = (standing.best(), is_ahead(params, standing));
    let limit = if difference_db > params.least_gain_db {
        format!("the {difference_db:.2} dB that another seed changes")
    } else {
        format!(
            "{} dB, and another seed changes {difference_db:.2} dB",
            params.least_gain_db
        )
    };
    let seeds = match standing.best_with_other_seed {
        Some(_) => " in the mean of two seeds",
        None => "",
    };
    let measured = format!(
        "{gain_db:+.2} dB over the defaults on {} validation photos after {} steps{seeds}",
        default.photos, default.steps
    );
    let decision = match (best, wins) {
        (0, _) => "the defaults stay: no trial is better".to_owned(),
        (_, true) => format!("trial {best:02} is chosen: {measured}, more than {limit}"),
        (_, false) => format!("the defaults stay: trial {best:02} has {measured}, not more than {limit}"),
    };
    let best_psnr = standing.judged.get(best as usize).map(|best| best.psnr);
    let with_other_seed = best_psnr.zip(standing.best_with_other_seed);
    Scatter {
        psnr: [default.psnr, standing.other_seed.psnr],
        best_psnr: with_other_seed.map(|(psnr, other)| [psnr, other.psnr]),
        difference_db,
        best_minus_default_db: gain_db,
        chosen: if wins { best } else { 0 },
        decision,
    }
}

/// Returns the trials by number, with their ranks.
fn ranked(params: &TuneParams, standing: &Standing) -> Vec<Trial> {
    let mut ranks = vec![0; standing.judged.len()];
    for (rank, index) in (1_u32..).zip(standing.ranking()) {
        ranks[index] = rank;
    }
    let rows = (0_u32..).zip(&standing.judged).zip(ranks);
    rows.map(|((trial, judged), rank)| Trial {
        trial,
        rank,
        steps: judged.steps,
        judged_px: judged.judged_px,
        psnr: judged.psnr,
        psnr_paper: judged.psnr_paper,
        ssim: judged.ssim,
        params: sample_params(&params.space, params.seed, trial),
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Tune;
    use marf_cache::Digest;
    use marf_schema::example;
    use marf_stage::{Define, Expand, Inputs, harness::Harness};
    use serde_json::json;

    /// Reduces a random search whose trials have these PSNRs, then the defaults with another seed, and the best trial with it.
    fn reduced(trials: usize, psnr: &[f64]) -> (Vec<Trial>, Scatter, serde_json::Value, Outputs) {
        let harness = Harness::default();
        let child = |psnr: &f64| {
            let mut metrics = example::train_metrics();
            (metrics.scores.psnr, metrics.scores.psnr_paper) = (*psnr, None);
            metrics.scores.ssim = Some(0.5);
            let mut outputs = Outputs::new();
            outputs.put(&harness.ctx(), &metrics).unwrap();
            outputs
        };
        let children: Vec<Outputs> = psnr.iter().map(child).collect();
        let table = json!({"search": "random", "trials": trials, "field": {"cone": 0.05}});
        let stage = Tune::new(serde_json::from_value(table).unwrap()).unwrap();
        let outputs = stage
            .reduce(&harness.ctx(), &Inputs::default(), &children)
            .unwrap();
        let bytes = |name: &str| harness.get(&outputs[name]).unwrap();
        (
            serde_json::from_slice(&bytes("trials")).unwrap(),
            serde_json::from_slice(&bytes("scatter")).unwrap(),
            serde_json::from_slice(&bytes("params")).unwrap(),
            outputs,
        )
    }

    #[test]
    fn a_gain_beyond_the_scatter_wins_and_its_keys_lie_over_the_base() {
        let (trials, scatter, params, _) = reduced(3, &[20.0, 19.0, 21.5, 20.25, 21.25]);
        assert_eq!(
            trials.iter().map(|trial| trial.rank).collect::<Vec<_>>(),
            [2, 3, 1]
        );
        assert_eq!(
            params["field"],
            json!(trials[2].params),
            "the draw sets `cone` too"
        );
        assert_eq!(
            (
                scatter.chosen,
                scatter.difference_db,
                scatter.best_minus_default_db
            ),
            (2, 0.25, 1.25)
        );
        assert_eq!(
            (scatter.psnr, scatter.best_psnr),
            ([20.0, 20.25], Some([21.5, 21.25]))
        );
        assert_eq!(
            scatter.decision,
            "trial 02 is chosen: +1.25 dB over the defaults on 1 validation photos after 400 steps in the mean of two seeds, \
             more than the 0.25 dB that another seed changes"
        );
    }

    #[test]
    fn a_gain_within_the_scatter_or_below_the_least_leaves_the_defaults() {
        for (psnr, limit) in [
            (
                vec![20.0, 20.25, 20.5],
                "not more than the 0.50 dB that another seed changes",
            ),
            (
                vec![20.0, 20.5, 20.5],
                "not more than the 0.50 dB that another seed changes",
            ),
            (
                vec![20.0, 20.0625, 20.0],
                "not more than 0.1 dB, and another seed changes 0.00 dB",
            ),
            // Ahead with one seed only: it was luck.
            (
                vec![20.0, 22.0, 20.25, 20.5],
                "not more than the 1.50 dB that another seed changes",
            ),
        ] {
            let (trials, scatter, params, _) = reduced(2, &psnr);
            assert_eq!((trials[1].rank, scatter.chosen), (1, 0), "{psnr:?}");
            assert_eq!(params, json!({ "field": {"cone": 0.05} }), "{psnr:?}");
            let decision = &scatter.decision;
            assert!(
                decision.starts_with("the defaults stay: trial 01 has +"),
                "{decision}"
            );
            assert!(decision.ends_with(limit), "{decision}");
        }
    }

    #[test]
    fn of_equal_trials_the_defaults_win() {
        let (trials, scatter, params, _) = reduced(2, &[20.0, 20.0, 20.0]);
        assert_eq!((trials[0].rank, scatter.chosen), (1, 0));
        assert_eq!(scatter.decision, "the defaults stay: no trial is better");
        assert_eq!(params, json!({ "field": {"cone": 0.05} }));
    }

    #[test]
    fn a_trial_that_is_missing_is_named() {
        let harness = Harness::default();
        let stage =
            Tune::new(serde_json::from_value(json!({"search": "random", "trials": 1})).unwrap()).unwrap();
        let error = stage
            .reduce(&harness.ctx(), &Inputs::default(), &vec![Outputs::new(); 2])
            .unwrap_err();
        assert_eq!(error.to_string(), "trial 00 has no output `metrics`");
        let error = stage.reduce(&harness.ctx(), &Inputs::default(), &[]).unwrap_err();
        assert!(error.to_string().contains("got 0"), "{error}");
    }

    /// If this digest changes and `Tune::VERSION` does not, raise the version.
    #[test]
    fn the_answer_belongs_to_the_version() {
        let outputs = reduced(3, &[20.0, 19.0, 21.5, 20.25, 21.25]).3;
        let all = Digest::from_content(&serde_json::to_vec(&outputs).unwrap());
        assert_eq!(
            (Tune::VERSION, all.short().as_str()),
            (8, "bef13b577428"),
            "{outputs:?}"
        );
    }
}
