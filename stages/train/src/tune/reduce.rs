use marf_schema::{
    train::Metrics,
    tune::{BestParams, Scatter, Trial, Trials, TuneParams},
};
use marf_stage::{Ctx, Outputs, StageError, TypedOutputs};

use super::sampling::sample_params;
use crate::child::Child;

/// Ranks the trials and writes what the best one had set.
pub(crate) fn reduce(
    ctx: &Ctx<'_>,
    params: &TuneParams,
    children: &[Outputs],
) -> Result<Outputs, StageError> {
    let trained = (0_u32..).zip(children).map(|(index, outputs)| {
        let name = format!("trial {index:02}");
        Child { name, outputs }.read::<Metrics>(ctx)
    });
    let mut trained = trained.collect::<Result<Vec<_>, _>>()?;
    let (Some(again), true) = (trained.pop(), children.len() == params.trials as usize + 1) else {
        let message = format!(
            "{} trials and the scatter were asked for, {} came",
            params.trials,
            children.len()
        );
        return Err(StageError::new(message));
    };
    let trials = ranked(params, &trained);
    let best = trials.iter().min_by_key(|trial| trial.rank);
    let (Some(best), Some(default)) = (best, trials.first()) else {
        return Err(StageError::new("no trial came back"));
    };
    let scatter = Scatter {
        psnr: [default.psnr, again.scores.psnr],
        difference_db: (default.psnr - again.scores.psnr).abs(),
        best_minus_default_db: best.psnr - default.psnr,
    };
    let mut outputs = Outputs::new();
    let field = best.params.clone();
    outputs.put(ctx, &BestParams { field })?;
    outputs.put(ctx, &Trials(trials))?;
    outputs.put(ctx, &scatter)?;
    Ok(outputs)
}

/// Returns the trials by number, with their ranks.
fn ranked(params: &TuneParams, trained: &[Metrics]) -> Vec<Trial> {
    let mut order: Vec<usize> = (0..trained.len()).collect();
    order.sort_by(|a, b| {
        trained[*b]
            .scores
            .psnr
            .total_cmp(&trained[*a].scores.psnr)
            .then(a.cmp(b))
    });
    let mut ranks = vec![0; trained.len()];
    for (rank, index) in (1_u32..).zip(order) {
        ranks[index] = rank;
    }
    let rows = (0_u32..).zip(trained).zip(ranks);
    rows.map(|((trial, trained), rank)| Trial {
        trial,
        rank,
        psnr: trained.scores.psnr,
        psnr_paper: trained.scores.psnr_paper,
        ssim: trained.scores.ssim,
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
        let params = TuneParams {
            trials: psnr.len() as u32 - 1,
            ..TuneParams::default()
        };
        let stage = Tune::new(params).unwrap();
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
    fn the_best_trial_wins_and_the_seed_noise_stands_beside_it() {
        let (trials, scatter, params, _) = reduced(&[20.0, 19.0, 21.5, 20.25]);
        assert_eq!(
            trials.iter().map(|trial| trial.rank).collect::<Vec<_>>(),
            [2, 3, 1]
        );
        assert_eq!(params, json!({ "field": trials[2].params }));
        assert_eq!(
            (scatter.difference_db, scatter.best_minus_default_db),
            (0.25, 1.5)
        );
    }

    #[test]
    fn of_equal_trials_the_defaults_win() {
        let (trials, _, params, _) = reduced(&[20.0, 20.0, 20.0]);
        assert_eq!(trials[0].rank, 1);
        assert_eq!(params, json!({ "field": {} }));
    }

    #[test]
    fn a_trial_that_is_missing_is_named() {
        let harness = Harness::default();
        let stage = Tune::new(TuneParams {
            trials: 1,
            ..TuneParams::default()
        })
        .unwrap();
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
            (3, "8288c9ee041d"),
            "{outputs:?}"
        );
    }
}
