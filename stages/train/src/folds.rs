use marf_schema::{
    folds::{FoldReport, FoldsParams, Judged, Metrics},
    output::{HELDOUT, PHOTO, SCENE},
    train::{self, Fold, Setup, TrainParams},
};
use marf_stage::{
    ChildStage, Ctx, Document, Expand, Inputs, NodeSpec, Outputs, Port, StageError, Threads, TypedOutputs,
    stage,
};

use crate::{
    child::Child,
    io::{read_scene, read_setup},
    scoring::means,
    split::fold_of_each,
};

/// Judges every photo of a small scene by a field that was trained without its place.
///
/// Where few photos are held out, their mean says little. Each fold is a node `train` with the sizes and configuration of the node
/// `training`. It trains on the photos of all other folds, for a share of the steps, so it is shorter and has fewer photos than that
/// training. Photos that `calibrate` holds out are trained on as well: this judges the scene, not the delivered field.
#[derive(Debug)]
pub struct Folds {
    params: FoldsParams,
}

stage! {
    Folds { params: FoldsParams },
    Expand,
    Threads::All,
    about: "judges every photo of a small scene by a field trained without it",
    version: 1,
    ports: [
        Port::required("input", SCENE),
        Port::required("training", Setup::OUTPUT),
    ],
    outputs: [Metrics::OUTPUT, HELDOUT, PHOTO],
    device: device,
}

impl Expand for Folds {
    fn children(&self) -> Vec<ChildStage> {
        vec![ChildStage::new(&fold(&self.params, 0, self.params.folds))]
    }

    fn expand(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<NodeSpec>, StageError> {
        read_setup(ctx, inputs)?;
        let scene = read_scene(ctx, inputs)?;
        if scene.frames.len() >= self.params.below as usize {
            return Ok(Vec::new());
        }
        let last = fold_of_each(&scene, self.params.folds).into_iter().max();
        let count = last.map_or(0, |last| last + 1);
        // In one place alone there is nothing to judge it by.
        let folds = if count > 1 { 0..count } else { 0..0 };
        let nodes = folds.map(|index| {
            let train = fold(&self.params, index, count);
            NodeSpec::new(format!("fold-{index:02}"), &train, inputs)
        });
        nodes.collect()
    }

    fn reduce(&self, ctx: &Ctx<'_>, inputs: &Inputs, children: &[Outputs]) -> Result<Outputs, StageError> {
        let scene = read_scene(ctx, inputs)?;
        let whole: Setup = inputs.read(ctx)?;
        let mut outputs = Outputs::new();
        let metrics = Metrics {
            photos: scene.frames.len() as u64,
            below: self.params.below,
            judged: judged(ctx, &whole, children)?,
        };
        outputs.put(ctx, &metrics)?;
        let is_picture = |name: &str| name.starts_with(HELDOUT) || name.starts_with(PHOTO);
        let pictures = children.iter().flatten().filter(|(name, _)| is_picture(name));
        outputs.extend(pictures.map(|(name, digest)| (name.clone(), *digest)));
        Ok(outputs)
    }
}

/// Returns the training of one fold.
fn fold(params: &FoldsParams, index: u32, count: u32) -> TrainParams {
    TrainParams {
        fold: Some(Fold {
            index,
            count,
            share: params.share,
        }),
        device: params.device.clone(),
        ..TrainParams::default()
    }
}

/// Puts the scores of all folds together.
fn judged(ctx: &Ctx<'_>, whole: &Setup, children: &[Outputs]) -> Result<Option<Judged>, StageError> {
    let folds = Child::numbered("fold", children);
    let trained: Result<Vec<train::Metrics>, _> = folds.iter().map(|fold| fold.read(ctx)).collect();
    let trained = trained?;
    let Some(first) = trained.first() else {
        return Ok(None);
    };
    let report = |metrics: &train::Metrics| FoldReport {
        train_photos: metrics.train_photos,
        held_out_photos: metrics.held_out_photos,
        psnr: metrics.scores.psnr,
    };
    let (steps, folds) = (first.steps, trained.iter().map(report).collect());
    let mut views: Vec<_> = trained
        .into_iter()
        .flat_map(|metrics| metrics.scores.views)
        .collect();
    views.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(Some(Judged {
        scores: means(views),
        steps,
        steps_of_whole: whole.steps,
        folds,
    }))
}
