//! The totals of steps on a device: their result, the cost of their rays, the number that was not finite.

use marf_field::FieldError;
use marf_field::backend::Step;
use marf_field::schedule::UPDATE_EVERY;
use marf_field::state::{State, cost, with_cost};
use marf_field::training::Training;
use marf_shaders::{Total, faults};

/// Steps from which on costs decide one call late. Before, the first guess is far off and cells empty fast,
/// so that a cost of 16 steps ago is wrong: with it a training of 200 steps lost 0.2 dB.
pub const LATE_FROM: u64 = 16 * UPDATE_EVERY;

/// Returns the error of a step with a number that is not finite, by the first fault that the device found.
pub fn fault(training: &Training, total: &Total) -> FieldError {
    let tensor = match total.faults.trailing_zeros() {
        faults::DENSITY => "raw density",
        faults::LOGITS => "colour logits",
        faults::LOSS => "loss",
        faults::FEATURES => "gradient of the features",
        faults::NETWORKS => "gradient of the networks",
        faults::BACKGROUND => "background",
        _ => "gains",
    };
    FieldError::NotFinite {
        step: training.state.steps,
        tensor,
        place: "some sample of the batch".to_owned(),
        learning_rate: training.config.learning_rate,
    }
}

/// Adds what came of one step on the device.
pub fn add(sum: &mut Step, total: &Total) {
    let rays = u64::from(total.rays);
    *sum = sum.and(Step {
        steps: 1,
        loss: f64::from(total.loss) / (3 * rays.max(1)) as f64,
        rays,
        samples: total.kept.into(),
    });
}

/// Notes the cost of the rays of some steps. Their samples are now `longer` times as many.
pub fn note_costs(state: &mut State, totals: &[Total], longer: f64) {
    let costs = totals.iter().map(|total| {
        let rays = u64::from(total.rays).max(1);
        longer * cost(rays, total.visited.into(), total.kept.into())
    });
    state.late_samples_per_ray = Some(costs.fold(state.samples_per_ray, with_cost));
    if state.steps <= LATE_FROM {
        state.catch_up();
    }
}
