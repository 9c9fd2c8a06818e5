use crate::GpuError;

/// What keeps a field from being trained, rendered, read or resumed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FieldError {
    /// A GPU that is not there, too small, or failed.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// A hyper-parameter out of its range.
    #[error("`{key}` is {value}, must be {range}")]
    Config {
        /// The key.
        key: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        range: String,
    },
    /// Nothing to learn from.
    #[error("no views: a field needs at least one photo with a camera")]
    NoViews,
    /// A photo whose pixels do not fill its size, or a size of zero.
    #[error("view `{id}`: image of {width} x {height} with {pixels} pixels")]
    BadImage {
        /// The view.
        id: String,
        /// Width said.
        width: u32,
        /// Height said.
        height: u32,
        /// Pixels found.
        pixels: usize,
    },
    /// A photo whose mask hides every pixel.
    #[error("view `{id}`: its mask hides all of it: leave the photo out, or open a part of the mask")]
    AllHidden {
        /// The view.
        id: String,
    },
    /// A camera for another size than the photo's.
    #[error(
        "view `{id}`: the camera is for {camera_width} x {camera_height}, the image has {width} x {height}"
    )]
    SizeMismatch {
        /// The view.
        id: String,
        /// Width the camera is for.
        camera_width: u32,
        /// Height the camera is for.
        camera_height: u32,
        /// Width of the image.
        width: u32,
        /// Height of the image.
        height: u32,
    },
    /// A camera or pose that is not finite or not proper.
    #[error("view `{id}`: camera or pose is not finite, not positive or not a rotation")]
    BadCamera {
        /// The view.
        id: String,
    },
    /// A camera so far from the box of the scene that single precision cannot distinguish places in the box.
    #[error(
        "view `{id}`: its camera lies at {place:?} in half sides of the box ({half_side:e} world units): the limit is 1e6"
    )]
    OutOfBox {
        /// The view.
        id: String,
        /// The camera's centre, half sides from the centre of the box.
        place: [f64; 3],
        /// Half side of the box, world units.
        half_side: f64,
    },
    /// A sparse point that is not finite.
    #[error("point {index} is not finite: {position:?}")]
    BadPoint {
        /// Its number.
        index: usize,
        /// Its position.
        position: [f64; 3],
    },
    /// A number ran away in training: NaN, infinite or 2^30 and more. The trainer still holds the state
    /// before the step.
    #[error(
        "step {step}: `{tensor}` is not finite, or beyond 1e9, at {place}: lower `learning_rate` (now {learning_rate})"
    )]
    NotFinite {
        /// The step that was refused.
        step: u64,
        /// The tensor.
        tensor: &'static str,
        /// Where in it.
        place: String,
        /// The step size that was set.
        learning_rate: f64,
    },
    /// Bytes that are not a field or a checkpoint.
    #[error("not a {what}: {reason}")]
    Malformed {
        /// `field` or `checkpoint`.
        what: &'static str,
        /// Why.
        reason: String,
    },
    /// A checkpoint of another training.
    #[error("the checkpoint is of another training: its {what} differs")]
    OtherTraining {
        /// What differs.
        what: &'static str,
    },
}

impl FieldError {
    /// Returns whether a device has too little of something, so that a smaller training would fit.
    pub fn is_too_large(&self) -> bool {
        matches!(
            self,
            Self::Gpu(GpuError::Limit { .. } | GpuError::Memory { .. } | GpuError::TooLarge { .. })
        )
    }
}
