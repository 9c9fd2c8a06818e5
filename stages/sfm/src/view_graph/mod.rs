//! The view graph: photos as nodes, relative poses as edges.

mod components;
mod focal;
mod known;
mod links;
mod view;

pub use components::components;
pub use focal::refine_focal_lengths;
pub use known::{KnownView, relate_known};
pub use links::link_pair;
pub use view::{ComparedPair, Link, PosedCamera, SharedCamera, View, focal_known, max_error_px};
