use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;
use std::time::SystemTime;

use marf_cache::Digest;
use marf_engine::{
    Cancel, Event, Listener, NodeRun, NodeState, Options, Outcome, RunRecord, SharedResults, document,
};
use marf_schema::scenes::Scenes;
use marf_schema::scores::Scores;
use marf_schema::{bootstrap, evaluate, train};
use marf_stage::Document;
use parking_lot::Mutex;

use super::args::{Global, RunArgs};
use super::documents::{self, Documents};
use super::error::{CliError, Diagnostic};
use super::export::Exported;
use super::session::{NodeInfo, Session, warn};
use super::shared::Shared;
use super::{export, files, manual_lists, on, program, report, scenes, verdicts};
use marf_report::emptied;
use super::progress::{JsonLines, Progress};
use marf_progress::{Began, Estimate, EventFile, Expected, Trace, duration, event_folder};
use crate::terminal::{eprint_line, print_line};

/// `marf run`: runs what changed, writes pictures, models and the report.
pub fn run(global: &Global, args: &RunArgs, cancel: &Cancel) -> Result<(), CliError> {
    let selection = &args.selection;
    let session = scenes::found(Session::open(global, cancel)?, selection, global, cancel)?;
    let (to, from) = scenes::selected(&session, selection)?;
    let options = Options {
        to,
        from,
        executor: on::executor(args, cancel)?,
        ..options(global, &session.name)
    };
    let (record, ended) = run_and_export(&session, &options, global, args, cancel)?;
    if !global.json {
        print_line(&table(&record, &session));
    }
    if record.outcome != Outcome::Cancelled && !global.json {
        eprint_line(&format!("report: {}", args.out.join(document::REPORT).display()));
    }
    ended
}

/// How often the outputs of one run may be found damaged when they are written out.
const MAX_REPAIRS: usize = 8;

/// Runs a session's graph and writes its outputs. What turns out to be damaged is made again by another run.
fn run_and_export(
    session: &Session,
    options: &Options,
    global: &Global,
    args: &RunArgs,
    cancel: &Cancel,
) -> Result<(RunRecord, Result<(), CliError>), CliError> {
    let mut options = options.clone();
    for _ in 0..MAX_REPAIRS {
        let execution = Execution {
            trace: args.trace.as_deref(),
            documents: &|record| report::documents(session, record),
        };
        let (record, ended) = execute_as(session, &options, global, cancel, &execution)?;
        if record.outcome == Outcome::Cancelled {
            return Ok((record, ended));
        }
        match export::outputs(session, &record, &args.out)? {
            Exported::All => return Ok((record, ended)),
            Exported::Lost(lost) => {
                warn(format!("{}; it is made again", lost.what));
                options.lost = vec![lost.node];
            }
        }
    }
    Err(CliError::failed(format!(
        "outputs were damaged {MAX_REPAIRS} times while they were written"
    )))
}

/// Returns the run options that the global arguments give.
pub fn options(global: &Global, pipeline: &str) -> Options {
    let words: Vec<String> = std::env::args().skip(1).collect();
    Options {
        threads: global.threads,
        pipeline: pipeline.to_owned(),
        id: run_id(),
        command: format!("marf {}", words.join(" ")),
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
    Digest::of(seed.as_bytes()).to_string()[..16].to_owned()
}

/// Runs a session's graph and prints its progress. Returns the record, and beside it the error the verb ends with: the
/// first failure with its cause and hint, or [`CliError::Interrupted`] after Ctrl-C.
///
/// # Errors
/// An unknown node in the selection, or a store that cannot be read or written.
pub fn execute(
    session: &Session,
    options: &Options,
    global: &Global,
    cancel: &Cancel,
) -> Result<(RunRecord, Result<(), CliError>), CliError> {
    let execution = Execution {
        trace: None,
        documents: &|_| Ok(Documents::new()),
    };
    execute_as(session, options, global, cancel, &execution)
}

/// What a verb wants of a run beside its results.
pub struct Execution<'a> {
    /// Where to write a trace of the run.
    pub trace: Option<&'a Path>,
    /// Makes documents of the run beside its pipeline; a run that was stopped has none.
    pub documents: &'a dyn Fn(&RunRecord) -> Result<Documents, CliError>,
}

/// As [`execute`], with what else the verb wants of the run.
///
/// # Errors
/// As [`execute`]; a document that cannot be made.
pub fn execute_as(
    session: &Session,
    options: &Options,
    global: &Global,
    cancel: &Cancel,
    execution: &Execution<'_>,
) -> Result<(RunRecord, Result<(), CliError>), CliError> {
    let progress = match global.json {
        true => Progress::Json(JsonLines::new(options.id.clone())),
        false => Progress::for_stderr(),
    };
    let listener = RunListener {
        progress,
        trace: execution.trace.is_some().then(Trace::default),
        event_file: event_file(session, options),
        estimate: Estimate::new(&wanted(session, options), expected(session)),
        failure: Mutex::default(),
    };
    if !global.json {
        eprint_line(&format!("device  {}", devices(session)));
    }
    let shared = Shared::open(session, global, cancel)?;
    let options = Options {
        build: program::build(&session.store),
        shared: shared.clone().map(|shared| shared as Arc<dyn SharedResults>),
        ..options.clone()
    };
    let (graph, store) = (&session.graph, &session.store);
    let mut record = marf_engine::run_nodes(graph, store, &options, &listener, cancel)?;
    // Whatever becomes of its documents, the run is recorded.
    let (documents, made) = documents_of(session, &record, execution);
    record.documents = documents;
    let record = record.store(store, warn)?;
    match made {
        // A run in which nothing ran needs nothing of a store that it cannot write.
        Err(error) if store.is_read_only() => {
            warn(format!("the run keeps no documents: {}", error.message()));
        }
        made => made?,
    }
    if let Some(shared) = shared {
        shared.finish(session, &record)?;
    }
    if let (Some(file), Some(trace)) = (execution.trace, &listener.trace) {
        files::write(file, trace.json().to_string().as_bytes())?;
    }
    if manual_lists::any(&session.nodes) {
        let verdicts = verdicts::all(session, &record);
        manual_lists::without_effect(&session.nodes, &verdicts)
            .into_iter()
            .for_each(warn);
    }
    emptied_filters(session, &record).into_iter().for_each(warn);
    let failure = listener.failure.into_inner();
    let ended = match record.outcome {
        Outcome::Done => Ok(()),
        Outcome::Cancelled => Err(CliError::Interrupted),
        Outcome::Failed => Err(CliError::Failed(
            failure.unwrap_or_else(|| Diagnostic::new("a node failed")),
        )),
    };
    Ok((record, ended))
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

/// Returns the documents of a run, as many as could be made, and beside them why not all.
fn documents_of(
    session: &Session,
    record: &RunRecord,
    execution: &Execution<'_>,
) -> (Documents, Result<(), CliError>) {
    let mut documents = Documents::new();
    let mut make = || {
        documents.extend(documents::pipeline(session, record)?);
        if record.outcome != Outcome::Cancelled {
            documents.extend((execution.documents)(record)?);
        }
        Ok(())
    };
    let made = make();
    (documents, made)
}

/// Begins the file that `marf view` follows. Without one the run goes on: a store that cannot be written has none.
fn event_file(session: &Session, options: &Options) -> Option<EventFile> {
    if session.store.is_read_only() {
        return None;
    }
    let began = Began {
        event: "began",
        run: &options.id,
        pipeline: &session.name,
        command: &options.command,
        nodes: &wanted(session, options),
        upstream: upstream(session),
    };
    let created = EventFile::create(&event_folder(&session.store), &began);
    created
        .map_err(|error| warn(format!("`marf view` cannot follow this run: {error}")))
        .ok()
}

/// Returns the nodes that a run is about, producers first: those that are asked for with all that they read, else all.
fn wanted<'s>(session: &'s Session, options: &Options) -> Vec<&'s str> {
    let names = session.graph.names();
    if options.to.is_empty() {
        return names;
    }
    let upstream = upstream(session);
    let mut wanted: BTreeSet<&str> = options.to.iter().map(String::as_str).collect();
    // Consumers first: what a node reads stands before it.
    for name in names.iter().rev() {
        if wanted.contains(name) {
            wanted.extend(upstream.get(name).into_iter().flatten().copied());
        }
    }
    names.into_iter().filter(|name| wanted.contains(name)).collect()
}

/// Returns what each node reads, by name.
fn upstream(session: &Session) -> BTreeMap<&str, Vec<&str>> {
    let reads = session.graph.nodes().map(|node| {
        let names = node.edges.iter().map(|edge| edge.upstream.as_str());
        (
            node.name,
            names
                .collect::<BTreeSet<&str>>()
                .into_iter()
                .collect::<Vec<&str>>(),
        )
    });
    reads.filter(|(_, names)| !names.is_empty()).collect()
}

/// Runs that are asked how long their nodes took.
const RUNS_ASKED: usize = 5;

/// Returns what the last runs of this pipeline tell of how long its nodes take; a run that cannot be read tells nothing.
fn expected(session: &Session) -> Expected {
    let numbers = session.store.run_numbers().unwrap_or_default();
    let runs = numbers
        .into_iter()
        .rev()
        .filter_map(|number| marf_engine::run_of(&session.store, number).ok());
    let own: Vec<RunRecord> = runs
        .take(4 * RUNS_ASKED)
        .filter(|run| run.pipeline == session.name)
        .take(RUNS_ASKED)
        .collect();
    Expected::of(own.iter())
}

/// Returns what the nodes of a session run on: the GPUs, or `cpu`.
fn devices(session: &Session) -> String {
    let backends: Vec<String> = session.graph.backends().into_iter().collect();
    match backends.is_empty() {
        true => "cpu".to_owned(),
        false => backends.join("; "),
    }
}

/// Prints events and keeps the first failure: later ones often follow from it.
struct RunListener {
    progress: Progress,
    trace: Option<Trace>,
    /// What `marf view` reads while the run goes on.
    event_file: Option<EventFile>,
    estimate: Estimate,
    failure: Mutex<Option<Diagnostic>>,
}

impl Listener for RunListener {
    fn on_event(&self, event: &Event) {
        self.progress.on_event(event);
        if let Some(trace) = &self.trace {
            trace.on_event(event);
        }
        if let Some(file) = &self.event_file {
            file.on_event(event);
        }
        if let Some(standing) = self.estimate.after(event) {
            self.progress.on_standing(&standing);
            if let Some(file) = &self.event_file {
                file.on_standing(&standing);
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

/// Returns the nodes of a run as a table: state, time, result.
fn table(record: &RunRecord, session: &Session) -> String {
    let shown = || record.nodes.iter().filter(|node| node.parent.is_none());
    let width = shown().map(|node| node.name.len()).fold(16, usize::max);
    let mut lines = vec![format!(
        "{:<width$} {:<9} {:>12}  result",
        "node", "state", "time"
    )];
    for node in shown() {
        let time = if node.state == NodeState::Finished {
            duration(node.seconds)
        } else {
            String::new()
        };
        let state = state_word(node.state);
        lines.push(
            format!(
                "{:<width$} {state:<9} {time:>12}  {}",
                node.name,
                result(node, session)
            )
            .trim_end()
            .to_owned(),
        );
    }
    let ran = record
        .nodes
        .iter()
        .filter(|node| node.state == NodeState::Finished)
        .count();
    lines.push(format!(
        "{ran} of {} nodes ran in {}",
        record.nodes.len(),
        duration(record.seconds)
    ));
    lines.join("\n")
}

/// Returns the word for a state, as all verbs print it.
pub fn state_word(state: NodeState) -> &'static str {
    match state {
        NodeState::Reused => "reused",
        NodeState::Finished => "ran",
        NodeState::Failed => "failed",
        NodeState::Skipped => "skipped",
        NodeState::Cancelled => "stopped",
    }
}

/// Returns the result of a node in words: counts, means of its metrics, or the message of a failure.
fn result(node: &NodeRun, session: &Session) -> String {
    if matches!(node.state, NodeState::Failed | NodeState::Skipped) {
        return node.reason.clone();
    }
    let mut parts: Vec<String> = node
        .counts
        .iter()
        .map(|(what, count)| format!("{count} {}", what.replace('_', " ")))
        .collect();
    parts.extend(figures(node, session).unwrap_or_else(|error| vec![error.message().to_owned()]));
    parts.join(", ")
}

/// Returns the means of a node's metrics, if it is of a stage that has some.
fn figures(node: &NodeRun, session: &Session) -> Result<Vec<String>, CliError> {
    let of_scores = |scores: Scores| {
        let psnr = format!("held-out PSNR {:.3} dB", scores.psnr);
        let ssim = scores.ssim.map(|ssim| format!("SSIM {ssim:.3}"));
        [psnr].into_iter().chain(ssim).collect()
    };
    Ok(match node.stage.as_str() {
        train::Metrics::STAGE => of_scores(session.document::<train::Metrics>(node)?.scores),
        evaluate::Metrics::STAGE => of_scores(session.document::<evaluate::Metrics>(node)?.scores),
        Scenes::STAGE => {
            let scenes = session.document::<Scenes>(node)?;
            let photos: usize = scenes.scenes.iter().map(|scene| scene.photos.len()).sum();
            let left_out =
                (!scenes.skipped.is_empty()).then(|| format!("{} groups left out", scenes.skipped.len()));
            let found = [
                format!("{} scenes", scenes.scenes.len()),
                format!("{photos} photos"),
            ];
            found.into_iter().chain(left_out).collect()
        }
        bootstrap::Metrics::STAGE => {
            let metrics = session.document::<bootstrap::Metrics>(node)?;
            vec![format!("mean std {:.3}", metrics.std)]
        }
        _ => Vec::new(),
    })
}
