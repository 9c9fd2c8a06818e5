use marf_stage::StageError;

/// What keeps members from being reduced.
#[derive(Debug, thiserror::Error)]
pub enum BootstrapError {
    /// The scene cannot be read.
    #[error(transparent)]
    Scene(#[from] marf_scene::SceneError),
    /// A member without an output that the reduction needs.
    #[error("member {member:02} has no output `{output}`")]
    Missing {
        /// The member.
        member: usize,
        /// The output.
        output: String,
    },
    /// An output of a member that cannot be read.
    #[error("member {member:02}, output `{output}`: {cause}")]
    Malformed {
        /// The member.
        member: usize,
        /// The output.
        output: String,
        /// What the reader said.
        cause: String,
    },
    /// A GPU that is not there, too small, or failed.
    #[error(transparent)]
    Gpu(marf_field::FieldError),
    /// A picture that cannot be written.
    #[error("picture `{name}`: {cause}")]
    Picture {
        /// Its name.
        name: String,
        /// What the encoder said.
        cause: String,
    },
    /// Nowhere to look from.
    #[error("the scene has no viewpoint `{viewpoints}`")]
    NoViewpoint {
        /// The kind that was asked for.
        viewpoints: &'static str,
    },
}

impl From<BootstrapError> for StageError {
    fn from(error: BootstrapError) -> Self {
        let hint = matches!(error, BootstrapError::NoViewpoint { .. });
        let stage_error = Self::new(error.to_string());
        if hint {
            stage_error.hint("take other `viewpoints`")
        } else {
            stage_error
        }
    }
}
