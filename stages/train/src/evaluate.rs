use marf_cache::ContentHash;
use marf_field::{Device, Field};
use marf_scene::Frame;
use marf_stage::{Ctx, Define, Inputs, Outputs, ParamError, Port, Set, Stage, StageError, Threads, Work};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{
    Metrics, TrainError,
    judge::{get_json, judge, outputs, put_json},
    params,
    split::{Named, named},
    train::read_scene,
};

/// Photos that are compared with their renders.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, ContentHash)]
#[serde(rename_all = "snake_case")]
pub enum Which {
    /// Those held out of training.
    #[default]
    Heldout,
    /// Those trained on, as in the paper's table.
    Train,
    /// All of them.
    All,
}

/// Parameters of `evaluate`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema, ContentHash)]
#[serde(default, deny_unknown_fields)]
pub struct EvaluateParams {
    /// Photos that are compared.
    pub views: Which,
    /// Whole factor by which photos are shrunk; absent: that of the training.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<u32>,
    /// Which processor trains and renders: `auto` (a GPU where there is one, never a software adapter), `cpu`, `gpu`,
    /// or `gpu:NAME` for the adapter whose name holds NAME. Only what was opened is in the key.
    #[content_hash(skip)]
    pub device: Device,
}

/// Renders the views of photos and compares them with the photos.
#[derive(Debug)]
pub struct Evaluate {
    params: EvaluateParams,
}

/// Of `train`'s metrics, what is needed here.
#[derive(Debug, Deserialize)]
struct Trained {
    scale: u32,
}

/// Output `metrics` of `evaluate`.
#[derive(Debug, Serialize)]
struct Report {
    #[serde(flatten)]
    metrics: Metrics,
    scale: u32,
}

impl Define for Evaluate {
    type Params = EvaluateParams;
    const NAME: &'static str = "evaluate";
    const ABOUT: &'static str = "Compares renders of a trained field with photos";
    const VERSION: u32 = 3;
    const PORTS: &'static [Port] = &[
        Port::required("input", "weights"),
        Port::required("input", "scene"),
        Port::required("input", "metrics"),
    ];
    const OUTPUTS: &'static [&'static str] = &["metrics", "heldout/", "photo/"];

    fn new(params: EvaluateParams) -> Result<Self, ParamError> {
        params::check_scale(params.scale)?;
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
        let scene = read_scene(ctx, inputs.required("scene")?)?;
        let trained: Trained = get_json(ctx, "metrics", inputs.required("metrics")?)?;
        let scale = self.params.scale.unwrap_or(trained.scale);
        let field = Field::decode(&ctx.get(inputs.required("weights")?)?);
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
        let mut outputs = outputs([]);
        let metrics = judge(ctx, &field, &frames, scale, &mut outputs)?;
        outputs.insert("metrics".to_owned(), put_json(ctx, &Report { metrics, scale })?);
        Ok(outputs)
    }
}

impl Which {
    fn has(self, frame: &Frame) -> bool {
        match self {
            Self::Heldout => frame.held_out,
            Self::Train => !frame.held_out,
            Self::All => true,
        }
    }
}
