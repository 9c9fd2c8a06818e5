use marf_cache::ContentHash;
use marf_field::Field;
use marf_schema::{
    evaluate::{EvaluateParams, Metrics, Which},
    output::{HELDOUT, PHOTO, SCENE, WEIGHTS},
    train,
};
use marf_stage::{
    Ctx, Define, Document, Inputs, Outputs, ParamError, Params, Port, Set, Stage, StageError, Threads,
    TypedOutputs, Work,
};

use crate::{
    TrainError,
    judge::judge,
    split::{Named, named},
    train::read_scene,
};

/// Renders the views of photos and compares them with the photos.
#[derive(Debug)]
pub struct Evaluate {
    params: EvaluateParams,
}

impl Define for Evaluate {
    type Params = EvaluateParams;
    const NAME: &'static str = EvaluateParams::STAGE;
    const ABOUT: &'static str = "Compares renders of a trained field with photos";
    const VERSION: u32 = 3;
    const PORTS: &'static [Port] = &[
        Port::required("input", WEIGHTS),
        Port::required("input", SCENE),
        Port::required("input", train::Metrics::OUTPUT),
    ];
    const OUTPUTS: &'static [&'static str] = &[Metrics::OUTPUT, HELDOUT, PHOTO];

    fn new(params: EvaluateParams) -> Result<Self, ParamError> {
        params.check()?;
        Ok(Self { params })
    }
}

impl Stage for Evaluate {
    fn params(&self) -> &dyn ContentHash {
        &self.params
    }

    fn work(&self) -> Work<'_> {
        Work::Set(self)
    }

    fn threads(&self) -> Threads {
        Threads::All
    }

    fn backend_id(&self) -> Option<String> {
        self.params.device.class()
    }
}

impl Set for Evaluate {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let scene = read_scene(ctx, inputs.required(SCENE)?)?;
        let trained: train::Metrics = inputs.read(ctx)?;
        let scale = self.params.scale.unwrap_or(trained.scale);
        let field = Field::decode(&ctx.get(inputs.required(WEIGHTS)?)?);
        let field = field
            .and_then(|field| field.on(&self.params.device))
            .map_err(TrainError::from)?;
        let frames: Vec<Named<'_>> = named(&scene)
            .into_iter()
            .filter(|named| self.params.views.has(named.frame))
            .collect();
        if frames.is_empty() {
            let placed = scene.frames.len();
            return Err(match self.params.views {
                Which::Heldout => TrainError::NoHeldOut { placed },
                _ => TrainError::NoTraining {
                    placed,
                    held_out: placed,
                },
            }
            .into());
        }
        let mut outputs = Outputs::new();
        let scores = judge(ctx, &field, &frames, scale, &mut outputs)?;
        outputs.put(ctx, &Metrics { scores, scale })?;
        Ok(outputs)
    }
}
