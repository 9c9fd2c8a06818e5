use marf_engine::{Cancel, Event, Listener, NodeRun, NodeState, Options, Outcome, RunRecord};
use parking_lot::Mutex;

use super::args::{Global, RunArgs};
use super::error::{CliError, Complaint};
use super::session::Session;
use super::{by_hand, export, report, verdicts};
use crate::progress::{Voice, duration};

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
        crate::say(&table(&record, &session));
    }
    if record.outcome != Outcome::Cancelled {
        export::outputs(&session, &record, &args.out)?;
        report::refresh(&session, &record, &args.out.join("report.html"))?;
        if !global.json {
            crate::talk(&format!("report: {}", args.out.join("report.html").display()));
        }
    }
    ended
}

/// Returns the options every run of this command line has.
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

/// Runs a session's graph and tells of it; beside the record comes how it ended, as the exit code will say it:
/// the first failure with its cause and hint, or [`CliError::Interrupted`] after Ctrl-C.
///
/// # Errors
/// An unknown node in the selection, or a store that cannot be read or written.
pub fn execute(
    session: &Session,
    options: &Options,
    global: &Global,
    cancel: &Cancel,
) -> Result<(RunRecord, Result<(), CliError>), CliError> {
    let voice = if global.json {
        Voice::Json
    } else {
        Voice::for_people()
    };
    let ear = Ear {
        voice,
        failure: Mutex::default(),
    };
    if !global.json {
        let device = if session.devices.is_empty() {
            "cpu".to_owned()
        } else {
            session.devices.join("; ")
        };
        crate::talk(&format!("device  {device}"));
    }
    let record = marf_engine::run(&session.graph, &session.store, options, &ear, cancel)?;
    for line in by_hand::idle(&session.nodes, &verdicts::all(session, &record)) {
        crate::talk(&format!("warning: {line}"));
    }
    let failure = ear.failure.into_inner();
    let ended = match record.outcome {
        Outcome::Done => Ok(()),
        Outcome::Cancelled => Err(CliError::Interrupted),
        Outcome::Failed => Err(CliError::Failed(
            failure.unwrap_or_else(|| Complaint::new("a node failed")),
        )),
    };
    Ok((record, ended))
}

/// Passes events on and remembers the first failure: the others follow from it more often than not.
struct Ear {
    voice: Voice,
    failure: Mutex<Option<Complaint>>,
}

impl Listener for Ear {
    fn on_event(&self, event: &Event) {
        self.voice.on_event(event);
        if let Event::Failed {
            node,
            message,
            cause,
            hint,
        } = event
        {
            let complaint = Complaint {
                message: format!("{node}: {message}"),
                cause: cause.clone(),
                hint: hint.clone(),
            };
            self.failure.lock().get_or_insert(complaint);
        }
    }
}

/// The nodes of a run as a table: what became of each, how long, how many photos.
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

/// What a node came to: photos kept, the PSNR of a training, the message of a failure.
fn result(node: &NodeRun, session: &Session) -> String {
    if matches!(node.state, NodeState::Failed | NodeState::Skipped) {
        return node.reason.clone();
    }
    let mut parts: Vec<String> = node
        .counts
        .iter()
        .map(|(what, count)| format!("{count} {}", what.replace('_', " ")))
        .collect();
    let metrics = node
        .outputs
        .get("metrics")
        .and_then(|output| session.store.get(&output.digest).ok());
    let metrics = metrics.and_then(|bytes| serde_json::from_slice::<serde_json::Value>(&bytes).ok());
    for (key, label, unit) in [
        ("psnr", "held-out PSNR", " dB"),
        ("ssim", "SSIM", ""),
        ("std", "mean std", ""),
    ] {
        if let Some(value) = metrics
            .as_ref()
            .and_then(|metrics| metrics.get(key))
            .and_then(|value| value.as_f64())
        {
            parts.push(format!("{label} {value:.3}{unit}"));
        }
    }
    parts.join(", ")
}
