//! What runs now, and how the last run ended.

use std::collections::BTreeMap;

use marf_cache::Store;
use marf_engine::{Event, RunRecord};
use marf_model::select;
use marf_progress::format::duration;
use marf_progress::{EventLine, RunProgress, RunStart, event_folder};
use marf_view::lines_of_running;

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
    programs.retain(|program| subject.covers(&program.start.source, &program.start.pipeline));
    Ok(programs)
}

/// Returns the programs that have left these lines and run a pipeline.
pub fn programs(lines: &[Vec<String>]) -> Vec<RunningProgram> {
    let all = lines.iter().filter_map(|lines| RunningProgram::read(lines));
    all.filter(|program| !program.start.source.is_derived()).collect()
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

/// A running program, from its lines.
#[derive(Default)]
pub struct RunningProgram {
    /// Its first line. The nodes have their children below them, in the order in which they are shown.
    pub start: RunStart,
    /// The state of each node. A waiting node has none.
    pub nodes: BTreeMap<String, NodeProgress>,
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
        (!running.start.command.is_empty()).then_some(running)
    }

    fn take(&mut self, line: EventLine) {
        let event = match line {
            EventLine::Began(start) => {
                self.start = start;
                return;
            }
            EventLine::Standing { standing, .. } => {
                self.standing = Some(standing);
                return;
            }
            EventLine::Event(event) => event,
        };
        match event {
            Event::WillRun { node, .. } => self.set(node, "running", String::new()),
            Event::Reused { node, .. } => self.set(node, "reused", String::new()),
            Event::Progress {
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
            Event::Finished { node, seconds, .. } => self.set(node, "ran", duration(seconds)),
            Event::Failed { node, message, .. } => self.set(node, "failed", message),
            Event::Skipped { node, reason } => self.set(node, "skipped", reason),
            Event::Warning { .. } => {}
        }
    }

    fn set(&mut self, node: String, word: &'static str, note: String) {
        if !self.nodes.contains_key(&node) && !self.start.nodes.contains(&node) {
            let parent = parent_of(&node).to_owned();
            let place = self
                .start
                .nodes
                .iter()
                .rposition(|name| parent_of(name) == parent);
            self.start.nodes.insert(
                place.map_or(self.start.nodes.len(), |place| place + 1),
                node.clone(),
            );
        }
        self.nodes.insert(node, NodeProgress { word, note });
    }
}
