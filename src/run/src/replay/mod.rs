//! Runs made again.

mod plan;
mod request;
mod target;

pub use request::{ReplayReport, ReplayRequest, differs, is_equal, is_missing, replay};
