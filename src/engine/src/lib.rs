//! Plans and runs the graph of stages; knows no Mars, no image, no GPU.
//!
//! Invariant: what a node answers depends on its key alone, and the key on the contents it names; threads,
//! order, cancellation and history change only what runs again.

mod bench;
mod earlier;
mod event;
mod graph;
mod key;
mod lookup;
mod memo;
mod photos;
mod plan;
mod record;
mod run;
mod work;

pub use event::{Event, Listener, Silent};
pub use graph::{Edge, Graph, GraphError, NodeDecl, NodeView};
pub use key::Change;
pub use marf_stage::Cancel;
pub use plan::{PlanState, PlannedNode, plan, why};
pub use record::{EngineError, NodeRun, NodeState, Outcome, RunRecord, last_run, runs};
pub use run::{Options, run};
