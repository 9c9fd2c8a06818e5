//! The events of a run as data: JSON lines, the file that `marf view` follows, an estimate of the remaining time. Numbers as text.

mod estimate;
mod event_file;
mod json;
mod text;

pub use marf_stage::format;

pub use estimate::{Estimate, NodeTimes, RunProgress};
pub use event_file::{EventFile, EventLine, RunStart, event_folder};
pub use json::{Line, event_schema};
pub use text::sentence;
