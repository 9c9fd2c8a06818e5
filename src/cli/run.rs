use marf_engine::{Cancel, Event, Listener, NodeRun, NodeState, Options, Outcome, RunRecord};
use marf_schema::scores::Scores;
use marf_schema::{bootstrap, evaluate, train};
use marf_stage::Document;
use parking_lot::Mutex;

use super::args::{Global, RunArgs};
use super::error::{CliError, Diagnostic};
use super::session::Session;
use super::{export, manual_lists, report, verdicts};
use crate::progress::{Progress, duration};
use crate::terminal::{eprint_line, print_line};

/// `marf run`: runs what changed, writes pictures, models and the report.
pub fn run(global: &Global, args: &RunArgs, cancel: &Cancel) -> Result<(), CliError> {
    let session = Session::open(global)?;
    let selection = &args.selection;
    let options = Options {
        to: selection.to.iter().cloned().collect(),
        from: selection.from.iter().cloned().collect(),
        ..options(global, &session.name)
    };
    let (record, ended) = execute(&session, &options, global, cancel)?;
    if !global.json {
        print_line(&table(&record, &session));
    }
    if record.outcome != Outcome::Cancelled {
        export::outputs(&session, &record, &args.out)?;
        report::refresh(&session, &record, &args.out.join("report.html"))?;
        if !global.json {
            eprint_line(&format!("report: {}", args.out.join("report.html").display()));
        }
    }
    ended
}

/// Returns the run options that the global arguments give.
pub fn options(global: &Global, pipeline: &str) -> Options {
    let words: Vec<String> = std::env::args().skip(1).collect();
    Options {
        threads: global.threads,
        pipeline: pipeline.to_owned(),
        command: format!("marf {}", words.join(" ")),
        program: concat!("marf ", env!("CARGO_PKG_VERSION")).to_owned(),
        ..Options::default()
    }
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
    let progress = if global.json {
        Progress::Json
    } else {
        Progress::for_people()
    };
    let listener = RunListener {
        progress,
        failure: Mutex::default(),
    };
    if !global.json {
        let device = if session.devices.is_empty() {
            "cpu".to_owned()
        } else {
            session.devices.join("; ")
        };
        eprint_line(&format!("device  {device}"));
    }
    let record = marf_engine::run(&session.graph, &session.store, options, &listener, cancel)?;
    for line in manual_lists::without_effect(&session.nodes, &verdicts::all(session, &record)) {
        eprint_line(&format!("warning: {line}"));
    }
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

/// Prints events and keeps the first failure: later ones often follow from it.
struct RunListener {
    progress: Progress,
    failure: Mutex<Option<Diagnostic>>,
}

impl Listener for RunListener {
    fn on_event(&self, event: &Event) {
        self.progress.on_event(event);
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
    let mut lines = vec![format!("{:<16} {:<9} {:>12}  result", "node", "state", "time")];
    for node in record.nodes.iter().filter(|node| node.parent.is_none()) {
        let time = if node.state == NodeState::Finished {
            duration(node.seconds)
        } else {
            String::new()
        };
        let state = state_word(node.state);
        lines.push(
            format!(
                "{:<16} {state:<9} {time:>12}  {}",
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
        bootstrap::Metrics::STAGE => {
            let metrics = session.document::<bootstrap::Metrics>(node)?;
            vec![format!("mean std {:.3}", metrics.std)]
        }
        _ => Vec::new(),
    })
}
