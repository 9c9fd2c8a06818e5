use marf_scene::{Frame, Scene};
use marf_schema::{
    evaluate::{EvaluateParams, Metrics, Which},
    output::{HELDOUT, PHOTO, SCENE, WEIGHTS},
    train,
};
use marf_stage::{Ctx, Document, Inputs, Outputs, Port, Set, StageError, Threads, TypedOutputs, stage};

use crate::{
    TrainError,
    checkpoint::identity,
    depth_views::trained_photos,
    io::{read_field, read_scene},
    photos::PhotoReader,
    scoring::{Judge, JudgedPhotos},
    split::{NamedFrame, held_out, named_frames, split},
};

/// Renders the views of photos and compares them with the photos.
#[derive(Debug)]
pub struct Evaluate {
    params: EvaluateParams,
}

stage! {
    Evaluate { params: EvaluateParams },
    Set,
    Threads::All,
    about: "compares renders of a trained field with photos",
    version: 6,
    ports: [
        Port::required("input", WEIGHTS),
        Port::required("input", SCENE),
        Port::required("input", train::Metrics::OUTPUT),
    ],
    outputs: [Metrics::OUTPUT, HELDOUT, PHOTO],
    device: device,
}

impl Set for Evaluate {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let scene = read_scene(ctx, inputs)?;
        let trained: train::Metrics = inputs.read(ctx)?;
        let scale = self.params.scale.unwrap_or(trained.scale);
        let field = read_field(ctx, inputs.required(WEIGHTS)?, &self.params.device)?;
        let frames: Vec<NamedFrame<'_>> = named_frames(&scene)
            .into_iter()
            .zip(held_out(&scene, trained.fold))
            .filter(|(_, is_held_out)| self.params.views.has(*is_held_out))
            .map(|(named, _)| named)
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
        let photos = PhotoReader::for_field(ctx, &scene, scale, field.config());
        let of = identity(self, inputs, "");
        let trained = trained_photos(&field, &photos, &scene, &trained_on(&scene, &trained)?)?;
        let scores = Judge::new(ctx, of, &field, &photos).held_out(
            &frames,
            JudgedPhotos::ALL,
            &trained,
            &mut outputs,
        )?;
        outputs.put(ctx, &Metrics { scores, scale })?;
        Ok(outputs)
    }
}

/// Returns the photos that a training has used.
fn trained_on<'a>(scene: &'a Scene, trained: &train::Metrics) -> Result<Vec<&'a Frame>, TrainError> {
    let frames = split(scene, trained.holdout, trained.fold)?.training.into_iter();
    let used = frames.filter(|named| trained.has_drawn(&named.frame.id));
    Ok(used.map(|named| named.frame).collect())
}
