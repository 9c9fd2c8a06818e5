//! The run as a graph in JSON-LD: RO-Crate 1.1 and the Provenance Run Crate profile 0.5.
//!
//! ```text
//! ./ ─ mainEntity ─ the pipeline ─ step ─ #step/NODE ─ workExample ─ #tool/STAGE/VERSION
//!  └─ mentions ─ #run (CreateAction, instrument the pipeline)
//!              └ #action/NODE (CreateAction, instrument the tool, object its inputs and parameters, result its outputs)
//! #marf/run (OrganizeAction) ─ object ─ #control/NODE (ControlAction, instrument the step) ─ object ─ #action/NODE
//! ```
//! Every reference leads to an entity of the graph, without exception. An action is named by its key, and `subjectOf`
//! is the file whose blake3 digest the key is.

mod actions;
mod context;
mod entity;
mod files;
mod fixed;
mod input;
mod tools;

use serde_json::{Value, json};

pub(crate) use actions::{action_id, value_text};
use context::Context;
pub(crate) use entity::{ids, references};
pub use input::{CRATE_FORMAT, CRATE_PROFILE, Described, GraphInput, METADATA, root_name};
pub(crate) use tools::tool_id;

/// Returns the graph of a run. Equal runs give equal bytes.
pub fn graph(input: &GraphInput<'_>) -> Value {
    let context = Context::new(input);
    let mut entities = fixed::entities(&context);
    entities.extend(context.tools.entities());
    entities.extend(files::entities(&context));
    entities.extend(actions::entities(&context));
    json!({
        "@context": [
            "https://w3id.org/ro/crate/1.1/context",
            {
                "sha256": "https://w3id.org/ro/terms/workflow-run#sha256",
                "blake3": "urn:x-marf:terms:blake3",
            },
        ],
        "@graph": entities,
    })
}
