//! What runs now, and how the last run ended.

use std::collections::BTreeMap;

use marf_cache::Store;
use marf_engine::{RunRecord, RunSource};
use marf_model::select;
use marf_progress::format::duration;
use marf_progress::{RunProgress, event_folder};
use marf_view::lines_of_running;
use serde::Deserialize;

use crate::choice::subject;
use crate::context::Context;
use crate::error::{Diagnostic, Error};
use crate::scenes::parent_of;

/// Returns the running programs of the pipeline, the one that was started last first.
///
/// # Errors
/// A store that cannot be read.
pub fn running(context: &Context, store: &Store) -> Result<Vec<RunningProgram>, Error> {
    let subject = subject(context, store)?;
    let mut programs = programs(&lines_of_running(&event_folder(store)));
    programs.retain(|program| subject.covers(&program.source, &program.pipeline));
    Ok(programs)
}

/// Returns the programs that have left these lines and run a pipeline.
pub fn programs(lines: &[Vec<String>]) -> Vec<RunningProgram> {
    let all = lines.iter().filter_map(|lines| RunningProgram::read(lines));
    all.filter(|program| !program.source.is_derived()).collect()
}

/// Returns the newest run of the pipeline, in any state.
///
/// # Errors
/// A store that cannot be read, or has no run.
pub fn newest_run(context: &Context, store: &Store) -> Result<RunRecord, Error> {
    let subject = subject(context, store)?;
    let newest = select::newest(store, &subject, context.warnings())?;
    newest.ok_or_else(|| {
        let diagnostic = Diagnostic::new(format!("no run in {}", store.dir().display()));
        Error::Failed(
            diagnostic.hint("run `marf run` first, or name the folder of the pipeline with `-C DIR`"),
        )
    })
}

/// A line that a running program has written, with the fields that are shown.
#[derive(Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
enum Line {
    Began {
        pipeline: String,
        source: RunSource,
        command: String,
        nodes: Vec<String>,
        upstream: BTreeMap<String, Vec<String>>,
    },
    Standing(RunProgress),
    WillRun {
        node: String,
    },
    Reused {
        node: String,
    },
    Progress {
        node: String,
        done: u64,
        total: u64,
        note: String,
    },
    Finished {
        node: String,
        seconds: f64,
    },
    Failed {
        node: String,
        message: String,
    },
    Skipped {
        node: String,
        reason: String,
    },
    Warning {},
}

/// A running program, from its lines.
#[derive(Default)]
pub struct RunningProgram {
    /// Name of its pipeline.
    pub pipeline: String,
    /// The source of its run.
    pub source: RunSource,
    /// The command as typed.
    pub command: String,
    /// The nodes with their children below them, in the order in which they are shown.
    pub order: Vec<String>,
    /// The state of each node. A waiting node has none.
    pub nodes: BTreeMap<String, NodeProgress>,
    /// The nodes that each node reads, by name.
    pub upstream: BTreeMap<String, Vec<String>>,
    /// How far the whole run is, once it is known.
    pub standing: Option<RunProgress>,
}

/// How far a node is.
pub struct NodeProgress {
    /// Its state.
    pub word: &'static str,
    /// More about it.
    pub note: String,
}

impl RunningProgram {
    /// Reads the lines of a program. None unless the first line is the start of a run.
    fn read(lines: &[String]) -> Option<Self> {
        let mut running = Self::default();
        // A line of a newer version is passed over.
        let known = lines.iter().filter_map(|line| serde_json::from_str(line).ok());
        known.for_each(|line| running.take(line));
        (!running.command.is_empty()).then_some(running)
    }

    fn take(&mut self, line: Line) {
        match line {
            Line::Began {
                pipeline,
                source,
                command,
                nodes,
                upstream,
            } => {
                self.pipeline = pipeline;
                self.source = source;
                self.command = command;
                self.order = nodes;
                self.upstream = upstream;
            }
            Line::Standing(standing) => self.standing = Some(standing),
            Line::WillRun { node } => self.set(node, "running", String::new()),
            Line::Reused { node } => self.set(node, "reused", String::new()),
            Line::Progress {
                node,
                done,
                total,
                note,
            } => {
                let at = if total > 0 {
                    format!("{done}/{total}  {note}")
                } else {
                    note
                };
                self.set(node, "running", at);
            }
            Line::Finished { node, seconds } => self.set(node, "ran", duration(seconds)),
            Line::Failed { node, message } => self.set(node, "failed", message),
            Line::Skipped { node, reason } => self.set(node, "skipped", reason),
            Line::Warning {} => {}
        }
    }

    fn set(&mut self, node: String, word: &'static str, note: String) {
        if !self.nodes.contains_key(&node) && !self.order.contains(&node) {
            let parent = parent_of(&node).to_owned();
            let place = self.order.iter().rposition(|name| parent_of(name) == parent);
            self.order
                .insert(place.map_or(self.order.len(), |place| place + 1), node.clone());
        }
        self.nodes.insert(node, NodeProgress { word, note });
    }
}
