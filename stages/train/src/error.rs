use marf_field::FieldError;
use marf_schema::train::Memory;
use marf_stage::StageError;

/// What keeps a field from being trained, measured or rendered.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The scene cannot be read.
    #[error(transparent)]
    Scene(#[from] marf_scene::SceneError),
    /// The chosen hyper-parameters cannot be read.
    #[error("the input `params` is not what `tune` writes: {0}")]
    Params(String),
    /// The setup of another training cannot be read.
    #[error("the input `setup` is not what `train` writes: {0}")]
    Setup(String),
    /// A training that started from an earlier field, and is to be repeated with another seed or other photos.
    #[error(
        "the training that `training` names started from an earlier field (`warm_start`), and one with another seed or draw does not"
    )]
    WarmStarted,
    /// The state of a training that cannot be gone on from.
    #[error("the input `state` cannot be gone on from: {0}")]
    State(String),
    /// A state behind the step at which the training is to stop.
    #[error("the input `state` is of step {at}, behind `until`, which is {until}")]
    Behind {
        /// Step of the state.
        at: u64,
        /// Where the training is to stop.
        until: u64,
    },
    /// No photo to learn from.
    #[error("no photo to train on: {placed} photos have a camera, {held_out} of them are held out")]
    NoTraining {
        /// Photos with a camera.
        placed: usize,
        /// Photos held out.
        held_out: usize,
    },
    /// No photo to measure on.
    #[error("no photo is held out of {placed}, so the field could not be judged")]
    NoHeldOut {
        /// Photos with a camera.
        placed: usize,
    },
    /// A wait that leaves nothing for the training.
    #[error(
        "nothing of `within`, {within_s} s, is left to train in: {left_s:.1} s after what came before, and judging takes about \
         {judging_s:.1} s"
    )]
    NoTime {
        /// The whole wait, seconds.
        within_s: f64,
        /// Remaining time, seconds.
        left_s: f64,
        /// Time that judging takes, seconds.
        judging_s: f64,
    },
    /// No photo to watch a target by.
    #[error("no training photo of {photos} can be held back to watch `target_psnr` by")]
    NoValidation {
        /// Training photos.
        photos: usize,
    },
    /// A photo that cannot be decoded.
    #[error("photo `{id}`: {cause}")]
    Photo {
        /// The photo.
        id: String,
        /// What the decoder said.
        cause: marf_scene::DecodeError,
    },
    /// A photo of another size than its camera.
    #[error("photo `{id}` has {width} x {height} pixels, its camera is for {camera_width} x {camera_height}")]
    Size {
        /// The photo.
        id: String,
        /// Its width.
        width: u32,
        /// Its height.
        height: u32,
        /// Width the camera is for.
        camera_width: u32,
        /// Height the camera is for.
        camera_height: u32,
    },
    /// A reduction that leaves nothing of a photo.
    #[error("photo `{id}` of {width} x {height} pixels vanishes at `scale` {scale}")]
    Vanished {
        /// The photo.
        id: String,
        /// Its width.
        width: u32,
        /// Its height.
        height: u32,
        /// The requested reduction.
        scale: u32,
    },
    /// A training that does not fit, however few pixels of its photos are kept.
    #[error(
        "training on {photos} photos needs {needed_mb} MB ({training_mb} MB of it for the field), `memory` is {memory}"
    )]
    Memory {
        /// What was allowed.
        memory: Memory,
        /// Photos to train on.
        photos: usize,
        /// The least that is needed, MB.
        needed_mb: u64,
        /// What the field, its training state and a checkpoint take of it, MB.
        training_mb: u64,
    },
    /// A render that cannot be compared with its photo.
    #[error("photo `{id}`: {cause}")]
    Metric {
        /// The photo.
        id: String,
        /// Why.
        cause: marf_scene::metrics::MetricError,
    },
    /// The field refused.
    #[error(transparent)]
    Field(#[from] FieldError),
    /// A child node without an output that is needed.
    #[error("{node} has no output `{output}`")]
    MissingOutput {
        /// The node.
        node: String,
        /// The output.
        output: String,
    },
    /// An output of a child node that cannot be read.
    #[error("{node}, output `{output}`: {cause}")]
    MalformedOutput {
        /// The node.
        node: String,
        /// The output.
        output: String,
        /// What the reader said.
        cause: String,
    },
    /// A picture that cannot be written.
    #[error("picture `{name}`: {cause}")]
    Picture {
        /// Its name.
        name: String,
        /// What the encoder said.
        cause: String,
    },
    /// Pictures that cannot become a video.
    #[error(transparent)]
    Video(#[from] marf_video::VideoError),
    /// Nowhere to make maps at.
    #[error("the scene has no viewpoint `{viewpoints}`")]
    NoViewpoint {
        /// The requested kind.
        viewpoints: &'static str,
    },
    /// No camera that a path could be laid through.
    #[error("the scene has no photo to lay the path `{path}` through")]
    NoPath {
        /// The kind of path.
        path: &'static str,
    },
    /// No direction to circle around.
    #[error(
        "no orbit: the up direction of the scene is unknown, and those of its photos cancel each other out"
    )]
    NoUp,
    /// No retrainings to compare.
    #[error("`uncertainty` needs the retrainings of a bootstrap, and no `members` is connected")]
    NoMembers,
}

impl TrainError {
    /// Returns the key to turn or the command to run, if we know one.
    pub fn hint(&self) -> Option<String> {
        let text = match self {
            Self::NoTraining { placed: 0, .. } => {
                "see the verdicts of the filters and the unplaced photos of `calibrate`"
            }
            Self::NoTraining { .. } => "hold out fewer photos in `calibrate`",
            Self::NoHeldOut { .. } => {
                "hold out some photos in `calibrate`, or set `holdout = \"validation\"`"
            }
            Self::NoTime { .. } => "raise `within`, or the factor `scale` by which photos are shrunk",
            Self::NoValidation { .. } => "leave `target_psnr` out, or take more photos",
            Self::State(_) => "take steps, seed, photos and field of the training that was stopped",
            Self::WarmStarted => {
                "set `warm_start = false` in the training that `training` names, or leave this node out while the scene grows"
            }
            Self::Behind { .. } => "raise `until`",
            Self::Vanished { .. } => "lower `scale`",
            Self::Memory { needed_mb, .. } => {
                return Some(format!(
                    "set `memory = \"{needed_mb}MB\"` or more, or lower `field.log2_table` or `quality`"
                ));
            }
            Self::Field(FieldError::NotFinite { .. }) => "lower `field.learning_rate`",
            Self::Video(marf_video::VideoError::TooLarge { .. }) => {
                "lower `width`, or take the path `stills`, which no film is made of"
            }
            Self::NoPath { .. } | Self::NoUp => "take another `path`",
            Self::NoMembers => {
                "write `members = \"bootstrap\"`, the name of a node of the stage `bootstrap` that retrains this field"
            }
            Self::NoViewpoint { .. } => "take other `viewpoints`",
            _ => return None,
        };
        Some(text.to_owned())
    }
}

/// Returns the error of a field that cannot be rendered.
pub(crate) fn field_failed(error: FieldError) -> StageError {
    TrainError::from(error).into()
}

impl From<TrainError> for StageError {
    fn from(error: TrainError) -> Self {
        let stage_error = Self::new(error.to_string());
        match error.hint() {
            Some(hint) => stage_error.hint(hint),
            None => stage_error,
        }
    }
}
