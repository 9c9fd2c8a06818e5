//! Incremental mapping: choice of the first photos, of the next ones, and of the kept points (Schönberger and Frahm
//! 2016).
//!
//! Invariant: the result depends on the photos, the view graph and the seed alone. Each step over many tracks is a pure
//! function of one track, collected in order.

mod extend;
mod global_adjustment;
mod initial_pair;
mod input;
mod intruders;
mod lens;
mod map;
mod merge;
mod model;
mod options;
mod register;
mod tracks;
mod triangulate;

pub use extend::extend;
pub(crate) use global_adjustment::{FINE, own_covariances, refine};
pub use global_adjustment::{PoseUncertainty, pose_uncertainties};
pub use input::{MapError, MapperInput};
pub use intruders::{FixedPart, HiddenPhoto, Intruders, remove_intruders};
pub use map::map;
pub use model::Model;
pub use options::{LensChoice, MapOptions, PrincipalPointChoice};
pub use tracks::{Observation, Tracks};
pub use triangulate::triangulate;

#[cfg(test)]
pub(crate) use merge::merge_last;
