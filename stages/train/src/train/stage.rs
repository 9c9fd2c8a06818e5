use marf_schema::{
    output::{HELDOUT, PHOTO, SCENE, STATE, WEIGHTS},
    train::{Curve, Metrics, Setup, TrainParams},
    tune::BestParams,
};
use marf_stage::{Ctx, Document, Inputs, Outputs, Port, Set, StageError, Threads, stage};

use super::{pilot::plan_by_time, plan::Plan, trained_field::TrainedField};
use crate::{io::read_scene, photos::PhotoReader};

/// Trains a field on a scene and measures it on the photos held out.
///
/// With `budget` or `within` it trains by the clock and is not a pure function, so its first result is kept. The key holds the time. The
/// schedule that was run, as setup and metrics print it, repeats the bytes anywhere (`schedule`).
///
/// With `from`, a state that `partial` saved of this very training, it continues from there and gives the same field as without.
///
/// With `warm_start` it starts from the field of its own last run if that fits the scene, and reports why if it does not.
///
/// With `training`, the setup of another training of the scene, it repeats that training with its own seed and draw of photos. Nothing is
/// derived from the photos drawn.
#[derive(Debug)]
pub struct Train {
    params: TrainParams,
}

stage! {
    Train { params: TrainParams },
    Set,
    Threads::All,
    about: "trains a radiance field and measures it on held-out photos",
    version: 25,
    ports: [
        Port::required("input", SCENE),
        Port::optional("params", BestParams::OUTPUT),
        Port::optional("training", Setup::OUTPUT).deciding(&[
            "params",
            "quality",
            "steps",
            "budget",
            "within",
            "schedule",
            "target_psnr",
            "scale",
            "photos",
            "memory",
            "holdout",
            "fit",
            "field",
            "warm_start",
        ]),
        Port::optional("from", STATE).deciding(&["warm_start"]),
    ],
    outputs: [
        WEIGHTS,
        Metrics::OUTPUT,
        Setup::OUTPUT,
        Curve::OUTPUT,
        SCENE,
        HELDOUT,
        PHOTO,
    ],
    device: device,
    {
        fn earlier(&self) -> Option<&'static str> {
            self.params.warm_start.then_some(WEIGHTS)
        }
    },
}

impl Set for Train {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let params = &self.params;
        let scene = read_scene(ctx, inputs)?;
        let mut plan = Plan::new(ctx, self, params, inputs, &scene)?;
        let photos = PhotoReader::for_field(ctx, &scene, plan.settings.scale, &plan.settings.config);
        plan_by_time(ctx, params, &mut plan, &photos)?;
        let photos = photos.at(&scene, plan.settings.scale);
        let trained = TrainedField::new(ctx, params, &plan, &photos)?;
        ctx.timed("judging", || trained.judge(ctx, params, inputs, &plan, &photos))
    }
}
