//! Plans and runs the graph of stages, without any knowledge of Mars, images or GPUs.
//!
//! Invariant: the result of a node depends on its key alone, and the key on the contents it names. Threads, order,
//! cancellation and history change only which nodes run.

mod check;
mod command;
mod earlier;
mod errors;
mod event;
mod executor;
mod graph;
mod items;
mod key;
mod listing;
mod lookup;
mod measure_table;
mod needs;
mod photo_changes;
mod plan;
mod record;
mod roots;
mod run;
pub mod sets;
mod shared;
mod source;
mod stage_io;
mod state_listener;
mod work;

pub use check::{Edge, GraphError, NodeShape, check};
pub use command::{forget_folders, recorded_command, without_archive_folders};
pub use event::{Event, Listener, SilentListener};
pub use executor::{Executor, Machine, Order};
pub use graph::{Graph, NodeDecl, NodeView};
pub use key::{Change, action_at, changes, differences};
pub use listing::Listings;
pub use marf_cache::LISTING;
pub use marf_stage::Cancel;
pub use needs::Needs;
pub use photo_changes::photo_changes;
pub use plan::{PlanOptions, PlanState, PlannedNode, plan, why};
pub use record::{
    Build, EngineError, NodeInput, NodeRun, NodeState, Outcome, OutputName, RUN_FORMAT, RecordError,
    RunRecord, document, last_run, last_run_where, run_of, runs,
};
pub use roots::{KeptRuns, kept_runs};
pub use run::{ActionError, ActionJob, Options, run, run_nodes};
pub use shared::SharedResults;
pub use source::{Purpose, RunSource};
pub use state_listener::StateListener;
pub use work::Extent;
