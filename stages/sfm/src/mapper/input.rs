//! Input and errors of the mapper.

use super::options::MapOptions;
use super::tracks::Tracks;
use crate::bundle::BundleError;
use crate::view_graph::{Link, SharedCamera, View};

/// Smallest number of photos of a model, if there are that many.
pub(super) const MIN_PHOTOS: usize = 3;

/// Why mapping ended without a result.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// `stop` returned true.
    #[error("stopped")]
    Stopped,
    /// A bundle adjustment was refused.
    #[error(transparent)]
    Bundle(#[from] BundleError),
}

/// Everything the mapper works on.
pub struct MapperInput<'a> {
    /// The photos.
    pub views: &'a [View],
    /// Their cameras.
    pub cameras: &'a [SharedCamera],
    /// The view graph.
    pub links: &'a [Link],
    /// Tracks of the view graph.
    pub tracks: Tracks,
    /// Options.
    pub options: MapOptions,
    /// Polled regularly: whether to stop. Once true, it stays so, and mapping ends with [`MapError::Stopped`].
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// Receives the number of photos registered so far.
    pub registered: &'a (dyn Fn(usize) + Sync),
}

impl MapperInput<'_> {
    /// Ends a computation that is to stop.
    ///
    /// # Errors
    /// [`MapError::Stopped`]: the last step may then have been cut short, and its result is worth nothing.
    pub(super) fn check_stop(&self) -> Result<(), MapError> {
        if (self.stop)() {
            return Err(MapError::Stopped);
        }
        Ok(())
    }
}
