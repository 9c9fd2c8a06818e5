//! Runs made again.

mod plan;
mod request;
mod target;

pub use request::{ReplayReport, differs, is_equal, is_missing, replay};
