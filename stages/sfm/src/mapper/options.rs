//! Options of the mapper.

use crate::bundle::LensModel;
use crate::view_graph::{SharedCamera, max_error_px};

/// Which distortion model a scene gets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LensChoice {
    /// The smallest model that the photos support.
    Smallest {
        /// The model in use while photos are registered.
        growing: LensModel,
    },
    /// This model.
    Fixed(LensModel),
}

/// Whether the principal point is free in the last adjustment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PrincipalPointChoice {
    /// Fixed.
    Fixed,
    /// Free.
    Free,
    /// Free if the photos determine it and the information criterion prefers it.
    Supported,
}

/// Options of the mapper.
#[derive(Debug, Clone)]
pub struct MapOptions {
    /// Largest reprojection error of an observation, pixels of the working size.
    pub max_error_px: f64,
    /// Smallest triangulation angle of a point.
    pub min_angle_rad: f64,
    /// Distortion model.
    pub lens: LensChoice,
    /// Principal point.
    pub principal_point: PrincipalPointChoice,
    /// Seed of all random samples.
    pub seed: u64,
}

impl LensChoice {
    /// Returns the model in use while photos are registered.
    pub(super) fn while_growing(self) -> LensModel {
        match self {
            Self::Smallest { growing } => growing,
            Self::Fixed(lens) => lens,
        }
    }
}

/// Smallest triangulation angle of a point (COLMAP).
const MIN_ANGLE_RAD: f64 = 1.5 * std::f64::consts::PI / 180.0;
impl MapOptions {
    /// Returns the options that suit the cameras: distortion and principal point as far as the photos support them.
    ///
    /// Photos whose focal lengths are all known within 5 % were resampled through the lens of their label. They are
    /// pinholes with a known principal point until the photos show otherwise.
    pub fn automatic(cameras: &[SharedCamera], seed: u64) -> Self {
        let largest = cameras
            .iter()
            .map(|shared| max_error_px(&shared.camera))
            .fold(0.0, f64::max);
        let labelled = cameras
            .iter()
            .all(|shared| shared.focal_sigma_share.is_some_and(|sigma| sigma < 0.05));
        Self {
            max_error_px: largest,
            min_angle_rad: MIN_ANGLE_RAD,
            lens: LensChoice::Smallest {
                growing: if labelled {
                    LensModel::Pinhole
                } else {
                    LensModel::Radial
                },
            },
            principal_point: if labelled {
                PrincipalPointChoice::Fixed
            } else {
                PrincipalPointChoice::Supported
            },
            seed,
        }
    }
}
