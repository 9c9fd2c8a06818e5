//! Computes an action, with its inputs from a shared store and its result into it.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use marf_cache::file::{self, FileKind, Links};
use marf_cache::{Action, Conflict, Digest, Record, Store, Upstream};
use marf_cluster::{BackendQuestion, Fault, JobProgress, JobResult};
use marf_engine::{ActionError, ActionJob, Event, Listener, Options};
use marf_field::{Device, DeviceError};
use marf_remote::{Patience, Reader, Remote, Traffic, in_words};
use parking_lot::Mutex;

use crate::context::{Context, RunFeedback, open_store};
use crate::documents::params_of;
use crate::error::{Diagnostic, Error};
use crate::program;
use crate::trust::trust;

/// Time between two writes of the file with the progress, which lies on a file system that many machines share.
const PROGRESS_INTERVAL: Duration = Duration::from_secs(2);

/// What was computed.
#[derive(Debug, Clone)]
pub enum ExecResult {
    /// The action, whose result is in the shared store, and what that moved.
    Action(Box<Action>, Traffic),
    /// The backend of a device of this machine. None for a CPU.
    Backend(Option<String>),
}

/// Computes an action, or answers which backend this machine has. `given` is a file with the action, or the key of a result in the shared
/// store. The outcome is written to `result`. Checkpoints and fetched blobs are in a folder of the job below `scratch`, by default
/// a temporary one. The folder of the job is kept until there is a result.
///
/// # Errors
/// A shared store that cannot be used, an action that cannot be computed here, a file that cannot be written.
pub fn exec(
    context: &Context,
    given: &str,
    result: Option<&Path>,
    scratch: Option<&Path>,
) -> Result<ExecResult, Error> {
    let remote = Remote::open(
        &address(context)?,
        Patience::Patient,
        trust(&[], context.signing)?,
    )?;
    let remote = Arc::new(remote);
    let cancel = context.cancel.clone();
    let reader = Arc::new(Reader::new(Arc::clone(&remote), move || cancel.is_set()));
    let task = Task::read(given, reader.as_ref())?;
    let outcome = match &task.work {
        Work::Action(action) => {
            let machine = Machine {
                context,
                result,
                scratch,
                remote: &remote,
            };
            machine.compute(action, reader)
        }
        Work::Backend(question) => backend_of(question),
    };
    if let Some(path) = result
        && !matches!(outcome, Err(Error::Interrupted))
    {
        let written = job_result(task.key, &outcome).write(path);
        written.map_err(|error| Error::failed(format!("{}: {error}", path.display())))?;
    }
    let outcome = outcome?;
    outcome
        .conflicts
        .iter()
        .map(in_words)
        .for_each(context.warnings());
    Ok(match task.work {
        Work::Action(action) => ExecResult::Action(action, remote.traffic()),
        Work::Backend(_) => ExecResult::Backend(outcome.backend),
    })
}

/// Returns the content of the file that reports the end of a job.
fn job_result(key: Digest, outcome: &Result<Outcome, Error>) -> JobResult {
    JobResult {
        key,
        program: program::PROGRAM.to_owned(),
        fault: outcome.as_ref().err().map(fault),
        backend: outcome.iter().find_map(|outcome| outcome.backend.clone()),
        warnings: outcome
            .iter()
            .flat_map(|outcome| &outcome.conflicts)
            .map(in_words)
            .collect(),
    }
}

/// The work of a job, with the digest of its bytes.
struct Task {
    key: Digest,
    work: Work,
}

/// The work of a job.
enum Work {
    /// Computes an action.
    Action(Box<Action>),
    /// Answers a run that plans for this machine.
    Backend(BackendQuestion),
}

/// The outcome of a job.
#[derive(Default)]
struct Outcome {
    /// Conflicts with results that were there.
    conflicts: Vec<Conflict>,
    /// The backend of the requested device.
    backend: Option<String>,
}

/// Returns the backend of a device of this machine.
fn backend_of(question: &BackendQuestion) -> Result<Outcome, Error> {
    let device: Device = question
        .backend_of
        .parse()
        .map_err(|error: DeviceError| Error::usage(error.to_string()))?;
    let backend = marf_field_gpu::opened_id(&device).map_err(|error| Error::failed(error.to_string()))?;
    Ok(Outcome {
        backend,
        ..Outcome::default()
    })
}

/// Returns the address of the shared store.
fn address(context: &Context) -> Result<String, Error> {
    let given = context.store.as_ref().and_then(|store| store.to_str());
    given.map(str::to_owned).ok_or_else(|| {
        let diagnostic = Diagnostic::new("--store is needed: inputs come from a shared store");
        Error::Usage(diagnostic.hint("file:///FOLDER or s3://BUCKET/PREFIX"))
    })
}

impl Task {
    /// Reads the task in a file, or the action of a key.
    fn read(given: &str, reader: &dyn Upstream) -> Result<Self, Error> {
        let bytes = match given.parse::<Digest>() {
            Ok(key) => reader
                .blob(&key)
                .map_err(Error::failed)?
                .filter(|bytes| Digest::from_content(bytes) == key)
                .ok_or_else(|| Error::failed(format!("the shared store has no action {}", key.short())))?,
            Err(_) => file::read(Path::new(given), FileKind::Document, Links::Followed)
                .map_err(|error| Error::usage(format!("{given}: {error}")))?,
        };
        // A file that jq or an editor wrote ends with a newline, which is not part of the task.
        let bytes = bytes.trim_ascii_end();
        let key = Digest::from_content(bytes);
        if let Some(question) = BackendQuestion::decode(bytes) {
            let work = Work::Backend(question);
            return Ok(Self { key, work });
        }
        let action = Action::decode(bytes).map_err(|error| Error::usage(format!("{given}: {error}")))?;
        let work = Work::Action(Box::new(action));
        Ok(Self { key, work })
    }
}

/// This machine, and the shared store that it computes for.
struct Machine<'a> {
    context: &'a Context,
    result: Option<&'a Path>,
    scratch: Option<&'a Path>,
    remote: &'a Remote,
}

impl Machine<'_> {
    /// Computes an action and sends its result. Returns the conflicts with results that were there.
    fn compute<R: Upstream + 'static>(&self, action: &Action, reader: Arc<R>) -> Result<Outcome, Error> {
        let kept = self.scratch;
        let temporary = kept.is_none().then(tempfile::tempdir).transpose();
        let temporary = temporary.map_err(|error| Error::failed(error.to_string()))?;
        let dir = kept
            .or(temporary.as_ref().map(|dir| dir.path()))
            .unwrap_or(Path::new("."));
        // The folder may hold other files of the user.
        let own = dir.join(action.key().to_string());
        let store = open_store(&own, &self.context.cancel)?.with_upstream(reader);
        let key = self.record(action, &store)?.key;
        let stop = || self.context.cancel.is_set();
        let sent = self.remote.send(&store, &[key], &[], &stop)?;
        drop(store);
        if let Some(dir) = kept {
            // A folder that cannot be removed only takes space.
            let _ = std::fs::remove_dir_all(&own);
            let _ = std::fs::remove_dir(dir); // it stays if it holds anything else
        }
        Ok(Outcome {
            conflicts: sent.conflicts,
            ..Outcome::default()
        })
    }

    /// Makes the result of an action in its own store.
    fn record(&self, action: &Action, store: &Store) -> Result<Record, Error> {
        let context = self.context;
        let listener = ActionListener {
            top: action.stage.clone(),
            file: self.result.map(JobProgress::path),
            written: Mutex::default(),
            feedback: context.feedback.follow(&action.key().short()),
            failure: Mutex::default(),
        };
        let options = Options {
            threads: context.threads,
            program: program::PROGRAM.to_owned(),
            ..Options::default()
        };
        let job = ActionJob::new(action, params_of(action), marf_stages::stages());
        let made = job.and_then(|job| job.run(store, &options, &listener, &context.cancel));
        let failure = listener.failure.into_inner();
        store.take_warnings().into_iter().for_each(context.warnings());
        made.map_err(|error| match error {
            ActionError::Failed(message) => {
                Error::Failed(failure.unwrap_or_else(|| Diagnostic::new(message)))
            }
            error => action_error(error),
        })
    }
}

fn action_error(error: ActionError) -> Error {
    match error {
        ActionError::Stopped => Error::Interrupted,
        ActionError::Failed(message) => Error::failed(message),
        ActionError::Store(error) => error.into(),
        ActionError::Engine(error) => error.into(),
        ActionError::Graph(error) => error.into(),
        error @ ActionError::Source { .. } => Error::Elsewhere(
            Diagnostic::new(format!("the action is of {error}"))
                .hint("`marf replay` fetches again, with the pipeline and its archive"),
        ),
        error @ ActionError::Part { .. } => Error::Elsewhere(
            Diagnostic::new(format!("the action is of {error}"))
                .hint("give the key of its node, or use `marf run`"),
        ),
        error => Error::Elsewhere(
            Diagnostic::new(format!("the action is of {error}"))
                .hint("use the marf that planned it, on a machine with the same backend"),
        ),
    }
}

fn fault(error: &Error) -> Fault {
    let diagnostic = error.diagnostic();
    Fault {
        message: error.message().to_owned(),
        is_elsewhere: matches!(error, Error::Elsewhere(_)),
        cause: diagnostic.and_then(|diagnostic| diagnostic.cause.clone()),
        hint: diagnostic.and_then(|diagnostic| diagnostic.hint.clone()),
    }
}

/// Passes events on, and keeps why the action failed.
struct ActionListener {
    feedback: Box<dyn RunFeedback>,
    failure: Mutex<Option<Diagnostic>>,
    /// Name of the node whose progress is written next to the result. Progress of its children is not written.
    top: String,
    file: Option<PathBuf>,
    /// When it was last written.
    written: Mutex<Option<Instant>>,
}

impl ActionListener {
    /// Replaces the file with the progress, if that is due. One that cannot be written costs the job nothing.
    fn write(&self, progress: &JobProgress) {
        let Some(file) = &self.file else { return };
        let mut written = self.written.lock();
        if written.is_none_or(|written| written.elapsed() >= PROGRESS_INTERVAL) {
            *written = Some(Instant::now());
            let _ = progress.write(file);
        }
    }
}

impl Listener for ActionListener {
    fn on_event(&self, event: &Event) {
        self.feedback.on_event(event);
        if let Event::Progress {
            node,
            done,
            total,
            note,
        } = event
            && *node == self.top
        {
            let (done, total, note) = (*done, *total, note.clone());
            self.write(&JobProgress { done, total, note });
        }
        if let Event::Failed {
            message, cause, hint, ..
        } = event
        {
            self.failure.lock().get_or_insert(Diagnostic {
                message: message.clone(),
                cause: cause.clone(),
                hint: hint.clone(),
            });
        }
    }
}
