//! What ran on what, as JSON-LD: RO-Crate 1.1 and the Provenance Run Crate profile 0.5.
//!
//! ```text
//! ./ ─ mainEntity ─ the pipeline ─ step ─ #step/NODE ─ workExample ─ #tool/STAGE/VERSION
//!  └─ mentions ─ #run (CreateAction, instrument the pipeline)
//!              └ #action/NODE (CreateAction, instrument the tool; object its inputs and parameters; result its outputs)
//! #marf/run (OrganizeAction) ─ object ─ #control/NODE (ControlAction, instrument the step) ─ object ─ #action/NODE
//! ```
//! Every reference leads to an entity of the graph, without exception. An action is named by its key, and `subjectOf`
//! is the file whose blake3 digest the key is.

mod actions;
mod entity;
mod files;
mod fixed;
mod tools;

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::{Action, Digest};
use serde_json::{Value, json};

use crate::bag::FileDigest;
use crate::contents::{Contents, File};
use crate::run::{Node, Run};

pub(crate) use actions::{action_id, value_text};
pub(crate) use entity::{ids, references};
use tools::Tools;
pub(crate) use tools::tool_id;

/// Name of the graph's file in the payload.
pub const METADATA: &str = "ro-crate-metadata.json";
/// Name of the page for people in the payload.
pub const PREVIEW: &str = "ro-crate-preview.html";
/// Version of the form of our crates; a newer one is refused.
pub const CRATE_FORMAT: u32 = 1;
/// What [`CRATE_FORMAT`] stands behind in the id of the profile of our crates.
pub const CRATE_PROFILE: &str = "urn:x-marf:crate:";

/// A file of the graph: in the crate, or named by its digest alone.
#[derive(Debug, Clone)]
pub struct Described<'a> {
    /// The file.
    pub file: &'a File,
    /// Its length and digests.
    pub digest: FileDigest,
    /// Its id: the path in the payload, or a URI with its SHA-256.
    pub id: String,
}

/// All that the graph is made of.
pub struct GraphInput<'a> {
    /// The run.
    pub run: &'a Run,
    /// What goes into the crate.
    pub contents: &'a Contents,
    /// Its described files.
    pub files: &'a [Described<'a>],
    /// Licence of the crate: an SPDX id or a URL; none if none was stated.
    pub license: Option<&'a str>,
}

/// What the parts of the graph look up.
struct Context<'a> {
    input: &'a GraphInput<'a>,
    ids: BTreeMap<Digest, &'a str>,
    by_path: BTreeMap<&'a str, &'a str>,
    tools: Tools,
    /// Nodes whose outputs no other node was given.
    terminal: BTreeSet<&'a str>,
}

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

impl<'a> Context<'a> {
    fn new(input: &'a GraphInput<'a>) -> Self {
        let files = input.files.iter();
        Self {
            input,
            ids: files
                .clone()
                .map(|described| (described.digest.blake3, described.id.as_str()))
                .collect(),
            by_path: files
                .map(|described| (described.file.path.as_str(), described.id.as_str()))
                .collect(),
            tools: Tools::of(input),
            terminal: terminal(input),
        }
    }

    fn run(&self) -> &'a Run {
        self.input.run
    }

    /// Returns the id of the file that tells the pipeline: as it was written, or the run root of a run that kept no text.
    fn pipeline(&self) -> &'a str {
        let written = self.run().written().and_then(|digest| self.ids.get(&digest));
        let root = || self.by_path.get(crate::contents::RUN_ROOT);
        written
            .or_else(root)
            .copied()
            .unwrap_or(crate::contents::RUN_ROOT)
    }

    fn action(&self, node: &Node) -> Option<&'a Action> {
        self.input.contents.actions.get(&node.key)
    }
}

/// Returns the nodes without a parent that no other such node is given the outputs of. What counts is who was connected to whom, not
/// who read the same bytes: a training passes its scene on, which other trainings read of `calibrate`.
fn terminal<'a>(input: &GraphInput<'a>) -> BTreeSet<&'a str> {
    let nodes = || input.run.nodes.iter().filter(|node| node.parent.is_none());
    let given: BTreeSet<&str> = nodes()
        .flat_map(|node| node.upstream.iter().map(String::as_str))
        .collect();
    let names = nodes().map(|node| node.name.as_str());
    names.filter(|name| !given.contains(name)).collect()
}
