use marf_schema::tune::{BestParams, Scatter, Trial, Trials, TuneParams};
use marf_stage::{Ctx, Outputs, StageError, TypedOutputs};

use super::{halving::miscounted, judged::Judged, sampling::sample_params};

/// Ranks the trials, decides between the best and the defaults, and writes the keys of the one that is chosen.
///
/// `judged`: every trial, by number; `again`: the defaults with another seed.
pub(super) fn reduce(
    ctx: &Ctx<'_>,
    params: &TuneParams,
    judged: &[Judged],
    again: &Judged,
) -> Result<Outputs, StageError> {
    let trials = ranked(params, judged);
    let best = trials.iter().min_by_key(|trial| trial.rank);
    let (Some(best), Some(default)) = (best, judged.first()) else {
        return Err(miscounted(params, judged.len()));
    };
    let scatter = decided(params, best, default, again);
    let chosen = sample_params(&params.space, params.seed, scatter.chosen);
    let mut outputs = Outputs::new();
    let field = params.field.with(&chosen);
    outputs.put(ctx, &BestParams { field })?;
    outputs.put(ctx, &Trials(trials))?;
    outputs.put(ctx, &scatter)?;
    Ok(outputs)
}

/// Decides between the best trial and the defaults, which win unless the gain is beyond what another seed changes.
fn decided(params: &TuneParams, best: &Trial, default: &Judged, again: &Judged) -> Scatter {
    let difference_db = (default.psnr - again.psnr).abs();
    let gain_db = best.psnr - default.psnr;
    let least_db = difference_db.max(params.least_gain_db);
    let wins = best.trial != 0 && gain_db > least_db;
    let limit = match difference_db > params.least_gain_db {
        true => format!("the {difference_db:.2} dB that another seed changes"),
        false => format!(
            "{} dB, and another seed changes {difference_db:.2} dB",
            params.least_gain_db
        ),
    };
    let measured = format!(
        "{gain_db:+.2} dB on {} validation photos after {} steps",
        default.photos, default.steps
    );
    let decision = match (best.trial, wins) {
        (0, _) => "the defaults stay: no trial is better".to_owned(),
        (trial, true) => {
            format!("trial {trial:02} is chosen: {measured} over the defaults, more than {limit}")
        }
        (trial, false) => {
            format!("the defaults stay: trial {trial:02} has {measured}, not more than {limit}")
        }
    };
    Scatter {
        psnr: [default.psnr, again.psnr],
        difference_db,
        best_minus_default_db: gain_db,
        chosen: if wins { best.trial } else { 0 },
        decision,
    }
}

/// Returns the trials by number, with their ranks: those that went further come first, then those with the better PSNR.
fn ranked(params: &TuneParams, judged: &[Judged]) -> Vec<Trial> {
    let mut order: Vec<usize> = (0..judged.len()).collect();
    order.sort_by(|&a, &b| {
        let (first, second) = (&judged[a], &judged[b]);
        let further = second.steps.cmp(&first.steps);
        further.then(second.psnr.total_cmp(&first.psnr)).then(a.cmp(&b))
    });
    let mut ranks = vec![0; judged.len()];
    for (rank, index) in (1_u32..).zip(order) {
        ranks[index] = rank;
    }
    let rows = (0_u32..).zip(judged).zip(ranks);
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

    /// Reduces a random search whose trials have these PSNRs, the last one being the scatter's.
    fn reduced(psnr: &[f64]) -> (Vec<Trial>, Scatter, serde_json::Value, Outputs) {
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
        let table = json!({"search": "random", "trials": psnr.len() - 1, "field": {"cone": 0.05}});
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
        let (trials, scatter, params, _) = reduced(&[20.0, 19.0, 21.5, 20.25]);
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
            (2, 0.25, 1.5)
        );
        assert_eq!(
            scatter.decision,
            "trial 02 is chosen: +1.50 dB on 1 validation photos after 400 steps over the defaults, more than the 0.25 dB \
             that another seed changes"
        );
    }

    #[test]
    fn a_gain_within_the_scatter_or_below_the_least_leaves_the_defaults() {
        for (psnr, limit) in [
            (
                [20.0, 20.25, 20.5],
                "not more than the 0.50 dB that another seed changes",
            ),
            (
                [20.0, 20.5, 20.5],
                "not more than the 0.50 dB that another seed changes",
            ),
            (
                [20.0, 20.0625, 20.0],
                "not more than 0.1 dB, and another seed changes 0.00 dB",
            ),
        ] {
            let (trials, scatter, params, _) = reduced(&psnr);
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
        let (trials, scatter, params, _) = reduced(&[20.0, 20.0, 20.0]);
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
        assert!(error.to_string().contains("0 came"), "{error}");
    }

    /// If this digest changes and `Tune::VERSION` does not, raise the version.
    #[test]
    fn the_answer_belongs_to_the_version() {
        let outputs = reduced(&[20.0, 19.0, 21.5, 20.25]).3;
        let all = Digest::of(&serde_json::to_vec(&outputs).unwrap());
        assert_eq!(
            (Tune::VERSION, all.short().as_str()),
            (4, "026bf046441f"),
            "{outputs:?}"
        );
    }
}
