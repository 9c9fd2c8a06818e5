//! Policy: which photos start a model, which come next, what is kept (Schönberger and Frahm 2016).
//!
//! Invariant: an answer depends on the photos, the links and the seed alone. Each step that works on many tracks
//! is a pure function of one track, collected in order.

mod grow;
mod join;
mod lens;
mod model;
mod refine;
mod start;
mod tracks;

use marf_scene::Camera;
use nalgebra::Vector2;

pub(crate) use join::join;
pub(crate) use lens::{CentreChoice, LensChoice};
pub(crate) use model::Model;
pub(crate) use refine::{Deviation, FINE, deviations, settle};
pub(crate) use tracks::Tracks;

use crate::bundle::BundleError;
use crate::two_view::{FocalKnown, Relation};

/// Why there is no model.
#[derive(Debug, thiserror::Error)]
pub(crate) enum MapError {
    #[error("stopped")]
    Stopped,
    #[error(transparent)]
    Bundle(#[from] BundleError),
}

/// A photo as the mapper sees it.
#[derive(Debug, Clone)]
pub(crate) struct View {
    /// Index of its camera.
    pub camera: usize,
    /// Features, pixels of the working size.
    pub pixels: Vec<Vector2<f64>>,
}

/// Lens and focal length that photos share, as they are known before.
#[derive(Debug, Clone)]
pub(crate) struct SharedCamera {
    pub camera: Camera,
    pub focal: FocalKnown,
    /// How well the focal length is known, as a share of it; `None`: a guess.
    pub focal_sigma_share: Option<f64>,
}

/// Two photos that see the same rigid scene, the lower index first.
#[derive(Debug, Clone)]
pub(crate) struct Link {
    pub photos: [usize; 2],
    pub relation: Relation,
}

/// What is asked of the mapper beside the photos.
#[derive(Debug, Clone)]
pub(crate) struct MapOptions {
    /// Largest reprojection error that is kept, pixels of the working size.
    pub max_error_px: f64,
    /// Smallest angle between two rays to a kept point.
    pub min_angle_rad: f64,
    pub lens: LensChoice,
    pub centre: CentreChoice,
    pub seed: u64,
}

/// Everything the mapper works on.
pub(crate) struct Task<'a> {
    pub views: &'a [View],
    pub cameras: &'a [SharedCamera],
    pub links: &'a [Link],
    pub tracks: Tracks,
    pub options: MapOptions,
    /// Asked now and then; a yes ends with [`MapError::Stopped`].
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// Told the photos placed so far.
    pub placed: &'a (dyn Fn(usize) + Sync),
}

/// Fewest photos of a model, if the set has that many.
const MIN_PHOTOS: usize = 3;

/// Adds all photos that fit to a model that has some already.
pub(crate) fn grow_from(task: &Task<'_>, model: Model) -> Result<Model, MapError> {
    grow::grow(task, model, &vec![false; task.views.len()])
}

/// Builds as many models as the photos fall into, the largest first.
///
/// A photo is in one model at most; none is forced in. An empty answer means that no pair of photos has both
/// enough matches and enough parallax.
pub(crate) fn map(task: &Task<'_>) -> Result<Vec<Model>, MapError> {
    let mut models: Vec<Model> = Vec::new();
    let mut taken = vec![false; task.views.len()];
    while let Some(model) = grow::best(task, &taken)? {
        let fresh = (0..taken.len()).filter(|&photo| model.poses[photo].is_some() && !taken[photo]);
        if fresh.count() < MIN_PHOTOS.min(task.views.len()) {
            break;
        }
        for (taken, pose) in taken.iter_mut().zip(&model.poses) {
            *taken |= pose.is_some();
        }
        models.push(model);
        models = join(task, models)?;
    }
    for model in &mut models {
        lens::finish(task, model)?;
    }
    models.sort_by_key(|model| (std::cmp::Reverse(model.photos().count()), model.photos().next()));
    Ok(models)
}
