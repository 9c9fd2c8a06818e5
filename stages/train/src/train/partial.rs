use marf_schema::{
    output::{SCENE, STATE},
    partial::{PartialParams, Reached},
    tune::BestParams,
};
use marf_stage::{Ctx, Document, Inputs, Outputs, Port, Set, StageError, Threads, TypedOutputs, stage};

use super::{
    log::packed_state,
    plan::Plan,
    training::{Training, run_of},
    training_loop::{save, train_to},
};
use crate::{TrainError, io::read_scene, photos::PhotoReader, scoring::mean_psnr};

/// Trains a field a part of the way and keeps the state, from which `train` or a longer `partial` goes on (`from`).
///
/// A training that is stopped and gone on with gives the field of one that is not, bit for bit.
#[derive(Debug)]
pub struct Partial {
    params: PartialParams,
}

stage! {
    Partial { params: PartialParams },
    Set,
    Threads::All,
    about: "trains the first steps of a training, from which `train` continues",
    version: 17,
    ports: [
        Port::required("input", SCENE),
        Port::optional("params", BestParams::OUTPUT),
        Port::optional("from", STATE),
    ],
    outputs: [STATE, Reached::OUTPUT],
    device: train.device,
}

impl Set for Partial {
    /// Trains until the step after which it stops, and measures the field as it is then.
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let PartialParams {
            until,
            judged_px,
            train,
        } = &self.params;
        let scene = read_scene(ctx, inputs)?;
        let plan = &Plan::new(ctx, self, train, inputs, &scene)?;
        let photos = &PhotoReader::for_field(ctx, &scene, plan.settings.scale, &plan.settings.config);
        let Training {
            mut trainer,
            curve_photos,
        } = Training::new(train, plan, photos)?;
        let mut planner = plan.planner();
        planner.until = Some(*until);
        let mut run = run_of(plan, &curve_photos, planner);
        let log = train_to(ctx, &mut run, &mut trainer)?;
        // Judging can be stopped, too. With the state saved, nothing is trained twice.
        save(ctx, &run, &log, &mut trainer)?;
        let field = trainer.field().map_err(TrainError::from)?;
        let held_out = &plan.photos.split.held_out;
        let thinned = photos.map(held_out, plan.memory.at_once, |_, photo| {
            photo.thinned_to(*judged_px)
        })?;
        let judged: Vec<_> = held_out.iter().cloned().zip(thinned).collect();
        let mut outputs = Outputs::new();
        let reached = Reached {
            until: *until,
            steps: plan.settings.schedule.steps(),
            psnr: mean_psnr(ctx, &field, &judged)?,
            held_out_photos: held_out.len() as u64,
            judged_px: *judged_px,
        };
        outputs.put(ctx, &reached)?;
        outputs.put_bytes(ctx, STATE, &packed_state(&log, &mut trainer)?)?;
        Ok(outputs)
    }
}
