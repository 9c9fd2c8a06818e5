//! Runs the graph of a session, with what belongs to every run: progress, documents, the shared store, warnings.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::SystemTime;

use marf_cache::Digest;
use marf_engine::{
    Event, Listener, Options, Outcome, RunRecord, SharedResults, SilentListener, StateListener,
};
use marf_progress::{Estimate, EventFile, NodeTimes, RunStart, event_folder};
use marf_report::emptied;
use parking_lot::Mutex;

use crate::context::RunFeedback;
use crate::documents::{self, Documents};
use crate::error::{Diagnostic, Error};
use crate::session::{NodeInfo, Session};
use crate::shared::Shared;
use crate::{manual_lists, program, verdicts};

/// Returns the options of a run of a session.
pub fn options(session: &Session) -> Options {
    let context = &session.context;
    Options {
        threads: context.threads,
        pipeline: session.name.clone(),
        id: run_id(),
        command: context.command.clone(),
        program: program::PROGRAM.to_owned(),
        ..Options::default()
    }
}

/// Returns 16 hexadecimal digits that no other run has: from the clock and the process id. They are in no result.
fn run_id() -> String {
    let since = SystemTime::now()
        .duration_since(SystemTime::UNIX_EPOCH)
        .unwrap_or_default();
    let seed = format!("{} {}", since.as_nanos(), std::process::id());
    Digest::from_content(seed.as_bytes()).to_string()[..16].to_owned()
}

/// A run that is over and recorded.
pub struct Execution {
    /// Its record.
    pub record: RunRecord,
    /// Why it is not done: the first failure with its cause and hint, or [`Error::Interrupted`].
    pub failure: Option<Error>,
}

impl Execution {
    /// Returns the record of a run that is done.
    ///
    /// # Errors
    /// Why it is not.
    pub fn done(self) -> Result<RunRecord, Error> {
        self.failure.map_or(Ok(self.record), Err)
    }
}

/// What a verb needs from a run in addition to its results.
pub struct Extras<'a> {
    /// Makes documents of the run in addition to its pipeline. A run that was stopped has none.
    pub documents: &'a dyn Fn(&RunRecord) -> Result<Documents, Error>,
    /// Also receives what happens in the run.
    pub listener: &'a dyn StateListener,
}

/// Runs a session's graph and reports its progress.
///
/// # Errors
/// An unknown node in the selection, or a store that cannot be read or written.
pub fn execute(session: &Session, options: &Options) -> Result<Execution, Error> {
    let extras = Extras {
        documents: &|_| Ok(Documents::new()),
        listener: &SilentListener,
    };
    execute_with(session, options, &extras)
}

/// As [`execute`], with what else the verb wants of the run.
///
/// # Errors
/// As [`execute`], and a document that cannot be made.
pub fn execute_with(session: &Session, options: &Options, extras: &Extras<'_>) -> Result<Execution, Error> {
    let context = &session.context;
    let listener = RunListener {
        feedback: context.feedback.follow(&options.id),
        event_file: event_file(session, options),
        estimate: Estimate::new(&nodes_to_run(session, options), expected(session)),
        failure: Mutex::default(),
        other: extras.listener,
    };
    listener.feedback.on_devices(&devices(session));
    let shared = Shared::open(session)?;
    let options = Options {
        source: session.source.clone(),
        build: program::build(&session.store, context.commit),
        shared: shared.clone().map(|shared| shared as Arc<dyn SharedResults>),
        ..options.clone()
    };
    let (graph, store) = (&session.graph, &session.store);
    let mut record = marf_engine::run_nodes(graph, store, &options, &listener, &context.cancel)?;
    // The run is recorded even if its documents fail.
    let mut made = Documents::new();
    let complete = add_documents(session, &record, extras, &mut made);
    record.documents = made;
    let record = record.store(store, context.warnings())?;
    match complete {
        // A run in which nothing ran needs nothing of a store that it cannot write.
        Err(error) if store.is_read_only() => {
            context.warn(format!("the run keeps no documents: {}", error.message()));
        }
        complete => complete?,
    }
    if let Some(shared) = shared {
        shared.finish(session, &record)?;
    }
    warn_of_lists_and_filters(session, &record);
    match verdicts::kept_as(session, &record) {
        Ok(lines) => lines.iter().for_each(|line| context.feedback.note(line)),
        Err(error) => context.warn(format!(
            "which photos are kept as monochrome is not known: {}",
            error.message()
        )),
    }
    let failure = listener.failure.into_inner();
    let failure = match record.outcome {
        Outcome::Done => None,
        Outcome::Cancelled => Some(Error::Interrupted),
        Outcome::Failed => Some(Error::Failed(
            failure.unwrap_or_else(|| Diagnostic::new("a node failed")),
        )),
    };
    Ok(Execution { record, failure })
}

/// Warns of names in lists that have no effect, and of filters that rejected every photo.
fn warn_of_lists_and_filters(session: &Session, record: &RunRecord) {
    if manual_lists::any(&session.nodes) {
        let verdicts = verdicts::all(session, record);
        manual_lists::without_effect(&session.nodes, &verdicts)
            .into_iter()
            .for_each(|message| session.context.warn(message));
    }
    emptied_filters(session, record)
        .into_iter()
        .for_each(|message| session.context.warn(message));
}

/// Returns one line for each filter that rejected every photo it was given.
fn emptied_filters(session: &Session, record: &RunRecord) -> Vec<String> {
    let line = |info: &NodeInfo| {
        let node = record.node(&info.name).filter(|node| node.state.is_good())?;
        let count = |what: &str| node.counts.get(what).copied().unwrap_or(0);
        let (kept, rejected) = (count("photos"), count("rejected"));
        let relax = info.relax.filter(|_| kept == 0 && rejected > 0)?;
        Some(emptied::sentence(&info.name, rejected, relax))
    };
    session.nodes.iter().filter_map(line).collect()
}

/// Adds the documents of a run, as many as can be made.
///
/// # Errors
/// The first that cannot.
fn add_documents(
    session: &Session,
    record: &RunRecord,
    extras: &Extras<'_>,
    documents: &mut Documents,
) -> Result<(), Error> {
    documents.extend(documents::pipeline(session, record)?);
    if record.outcome != Outcome::Cancelled {
        documents.extend((extras.documents)(record)?);
    }
    Ok(())
}

/// Starts the file that `marf view` follows. None for a run that is not public, and in a store that cannot be written: the run
/// continues without it.
fn event_file(session: &Session, options: &Options) -> Option<EventFile> {
    if session.store.is_read_only() || !session.context.feedback.is_public() {
        return None;
    }
    let nodes = nodes_to_run(session, options);
    let start = RunStart {
        run: options.id.clone(),
        pipeline: session.name.clone(),
        source: session.source.clone(),
        command: options.command.clone(),
        nodes: nodes.into_iter().map(str::to_owned).collect(),
        upstream: upstream(session),
    };
    let created = EventFile::create(&event_folder(&session.store), start);
    created
        .map_err(|error| {
            session
                .context
                .warn(format!("`marf view` cannot follow this run: {error}"))
        })
        .ok()
}

/// Returns the nodes that a run is about, producers first: the requested nodes with everything upstream, else all.
fn nodes_to_run<'s>(session: &'s Session, options: &Options) -> Vec<&'s str> {
    let names = session.graph.names();
    if options.to.is_empty() {
        return names;
    }
    let upstream = upstream(session);
    let mut needed: BTreeSet<&str> = options.to.iter().map(String::as_str).collect();
    // Consumers first: the producers of a node come before it in `names`.
    for name in names.iter().rev() {
        if needed.contains(name) {
            needed.extend(upstream.get(*name).into_iter().flatten().map(String::as_str));
        }
    }
    names.into_iter().filter(|name| needed.contains(name)).collect()
}

/// Returns the nodes that each node reads, by name.
fn upstream(session: &Session) -> BTreeMap<String, Vec<String>> {
    let reads = session.graph.nodes().map(|node| {
        let names: BTreeSet<&String> = node.edges.iter().map(|edge| &edge.upstream).collect();
        (
            node.name.to_owned(),
            names.into_iter().cloned().collect::<Vec<_>>(),
        )
    });
    reads.filter(|(_, names)| !names.is_empty()).collect()
}

/// Runs that are asked how long their nodes took.
const RUNS_ASKED: usize = 5;

/// Returns the expected times of nodes from the last runs of this pipeline. A run that cannot be read is skipped.
fn expected(session: &Session) -> NodeTimes {
    let numbers = session.store.run_numbers().unwrap_or_default();
    let runs = numbers
        .into_iter()
        .rev()
        .filter_map(|number| marf_engine::run_of(&session.store, number).ok());
    let own: Vec<RunRecord> = runs
        .take(4 * RUNS_ASKED)
        .filter(|run| run.pipeline == session.name && run.source.series() == session.source.series())
        .take(RUNS_ASKED)
        .collect();
    NodeTimes::from_runs(own.iter())
}

/// Returns what the nodes of a session run on: the GPUs, or `cpu`.
fn devices(session: &Session) -> String {
    let backends: Vec<String> = session.graph.backends().into_iter().collect();
    if backends.is_empty() {
        return "cpu".to_owned();
    }
    backends.join("; ")
}

/// Passes events on and keeps the first failure: later ones often follow from it.
struct RunListener<'a> {
    feedback: Box<dyn RunFeedback>,
    /// The file that `marf view` reads while the run continues.
    event_file: Option<EventFile>,
    estimate: Estimate,
    failure: Mutex<Option<Diagnostic>>,
    other: &'a dyn StateListener,
}

impl StateListener for RunListener<'_> {
    fn on_state(&self, record: &dyn Fn() -> Option<RunRecord>) {
        self.other.on_state(record);
    }
}

impl Listener for RunListener<'_> {
    fn on_event(&self, event: &Event) {
        self.feedback.on_event(event);
        self.other.on_event(event);
        if let Some(file) = &self.event_file {
            file.on_event(event);
        }
        if let Some(standing) = self.estimate.after(event) {
            self.feedback.on_run_progress(&standing);
            if let Some(file) = &self.event_file {
                file.on_run_progress(&standing);
            }
        }
        if let Event::Failed {
            node,
            message,
            cause,
            hint,
        } = event
        {
            let diagnostic = Diagnostic {
                message: format!("{node}: {message}"),
                cause: cause.clone(),
                hint: hint.clone(),
            };
            self.failure.lock().get_or_insert(diagnostic);
        }
    }
}
