use marf_schema::{
    output::{SCENE, STATE},
    partial::{PartialParams, Reached},
    tune::BestParams,
};
use marf_stage::{
    Ctx, Define, Document, Inputs, Outputs, ParamError, Params, Port, Set, Stage, StageError, Threads,
    TypedOutputs, Work,
};

use super::{
    Begun, Plan, planned,
    training_loop::{Run, packed_state, save, train_to},
};
use crate::{TrainError, photos::PhotoReader, scoring::mean_psnr};

/// Trains a field a part of the way and keeps the state, from which `train` or a longer `partial` goes on (`from`).
///
/// A training that is stopped and gone on with gives the field of one that is not, bit for bit.
#[derive(Debug)]
pub struct Partial {
    params: PartialParams,
}

impl Define for Partial {
    type Params = PartialParams;
    const NAME: &'static str = PartialParams::STAGE;
    const ABOUT: &'static str = "trains a part of the steps of a training, which `train` then goes on from";
    const VERSION: u32 = 11;
    const PORTS: &'static [Port] = &[
        Port::required("input", SCENE),
        Port::optional("params", BestParams::OUTPUT),
        Port::optional("from", STATE),
    ];
    const OUTPUTS: &'static [&'static str] = &[STATE, Reached::OUTPUT];

    fn new(params: PartialParams) -> Result<Self, ParamError> {
        params.check()?;
        Ok(Self { params })
    }
}

impl Stage for Partial {
    /// Without the device of the training, which changes no result.
    fn params(&self) -> serde_json::Value {
        let mut params = marf_stage::key_params(&self.params, &["train"]);
        params["train"] = marf_stage::key_params(&self.params.train, &["device"]);
        params
    }

    fn work(&self) -> Work<'_> {
        Work::Set(self)
    }

    fn threads(&self) -> Threads {
        Threads::All
    }

    fn backend_id(&self) -> Option<String> {
        self.params.train.device.backend_id()
    }

    fn backend_id_on(&self, gpu: Option<&str>) -> Result<Option<String>, StageError> {
        self.params
            .train
            .device
            .backend_id_on(gpu)
            .map_err(StageError::new)
    }
}

impl Set for Partial {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let train = &self.params.train;
        planned(ctx, (self, train), inputs, |plan, photos| {
            self.train(ctx, &plan, photos)
        })
    }
}

impl Partial {
    /// Trains until the step after which it stops, and measures the field as it is then.
    fn train(&self, ctx: &Ctx<'_>, plan: &Plan<'_>, photos: &PhotoReader<'_>) -> Result<Outputs, StageError> {
        let PartialParams {
            until,
            judged_px,
            train,
        } = &self.params;
        let (mut trainer, begun) = Begun::new(ctx, train, plan, photos)?;
        let run = Run {
            until: Some(*until),
            ..plan.run(&begun)
        };
        let log = train_to(ctx, &run, &mut trainer)?;
        // Judging is asked whether to stop, too: nothing is trained twice.
        save(ctx, &run, &log, &mut trainer)?;
        let field = trainer.field().map_err(TrainError::from)?;
        let held_out = &plan.split.held_out;
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
