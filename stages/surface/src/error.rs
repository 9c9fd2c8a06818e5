use marf_stage::{Cancel, StageError};

/// Errors of making or writing a surface.
#[derive(Debug, thiserror::Error)]
pub enum SurfaceError {
    /// The user asked to stop.
    #[error("stopped")]
    Cancelled,
    /// The scene cannot be read.
    #[error(transparent)]
    Scene(#[from] marf_scene::SceneError),
    /// The field cannot be read or rendered.
    #[error(transparent)]
    Field(#[from] marf_field::FieldError),
    /// A mask that cannot be read.
    #[error("the mask of photo `{id}`: {cause}")]
    Mask {
        /// The photo.
        id: String,
        /// The fault.
        cause: String,
    },
    /// No photo to look from.
    #[error("no photo was trained on, so nothing was seen")]
    NoPhotos,
    /// No view shows a surface.
    #[error("the field shows no surface at the views of its {photos} photos")]
    NoSurface {
        /// Photos looked from.
        photos: usize,
    },
    /// A cell or a band that is not a length, or far too short for the extent of the scene.
    #[error("cells of {cell} and a band of {band} make no grid for this scene")]
    Layout {
        /// Distance between samples, world units.
        cell: f64,
        /// Width of the band, world units.
        band: f64,
    },
    /// More blocks than there may be.
    #[error(
        "with cells of {cell} the surfaces touch {blocks} blocks of the grid and more, at most {most} are taken"
    )]
    TooFine {
        /// Distance between samples, world units.
        cell: f64,
        /// Blocks found so far.
        blocks: usize,
        /// Most that are taken.
        most: usize,
    },
    /// A signed distance that is infinite.
    #[error("a sample of the grid is {value}")]
    NotFinite {
        /// The value.
        value: f32,
    },
    /// More than an index can count.
    #[error("{vertices} vertices are more than a file can count")]
    TooLarge {
        /// Vertices.
        vertices: usize,
    },
    /// A scene that cannot give the requested product.
    #[error("{what} cannot be made: {why}")]
    Refused {
        /// The requested product.
        what: &'static str,
        /// What the scene lacks.
        why: String,
    },
    /// A picture that could not be encoded.
    #[error(transparent)]
    Png(#[from] marf_scene::picture::png16::PngError),
    /// A GeoTIFF that could not be encoded.
    #[error("a GeoTIFF: {0}")]
    Tiff(#[from] tiff::TiffError),
}

/// Returns an error if the user asked to stop.
pub fn go_on(cancel: &Cancel) -> Result<(), SurfaceError> {
    if cancel.is_set() {
        return Err(SurfaceError::Cancelled);
    }
    Ok(())
}

impl SurfaceError {
    /// Returns the key to turn, if one is known.
    fn hint(&self) -> Option<&'static str> {
        match self {
            Self::TooFine { .. } => Some("raise `cell`, or lower `reach`"),
            Self::NoSurface { .. } => Some("train longer, or look at the held-out renders of the training"),
            Self::Refused { .. } => Some("cameras from labels give metres and an up direction"),
            _ => None,
        }
    }
}

impl From<SurfaceError> for StageError {
    fn from(error: SurfaceError) -> Self {
        if matches!(error, SurfaceError::Cancelled) {
            return Self::Cancelled;
        }
        let failed = Self::new(error.to_string());
        match error.hint() {
            Some(hint) => failed.hint(hint),
            None => failed,
        }
    }
}
