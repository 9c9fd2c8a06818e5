//! The live page: the report of a run, the progress of a running one, and a 3-D view of its field, served on one port.
//!
//! It knows no pipeline and writes no file: all contents come from a [`Source`]. Invariant: a request reaches
//! objects of the store by their digest alone, and only those that shown runs name. Every answer passes the
//! checks of `access`.

mod access;
mod answers;
mod connections;
mod content;
mod difference;
mod error;
mod events;
mod field;
mod frames;
mod measure;
mod page;
mod range;
mod renderer;
mod routes;
mod server;
mod site;
mod source;
mod splat_progress;
mod splats;
mod stream;

pub use access::AccessError;
pub use error::ViewError;
pub use events::lines_of_running;
pub use server::{Options, Server};
pub use source::{DepthInterval, FieldSource, Source};
pub use splat_progress::SplatProgress;
