//! `marf exec`: actions, their inputs from a shared store and their results into it.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Args;
use marf_cache::{Action, Conflict, Digest, Record, Upstream};
use marf_cluster::{BackendQuestion, Fault, JobProgress, JobResult};
use marf_engine::{ActionError, Cancel, Event, Listener, Options, run_action};
use marf_field::{Device, DeviceError};
use marf_remote::{Observer, Patience, Reader, Remote, in_words};
use parking_lot::Mutex;

use super::args::Global;
use super::cache::words;
use super::documents::params_of;
use super::error::{CliError, Diagnostic};
use super::program;
use super::session::{open_store, warn};
use super::trust::trust;
use super::progress::{JsonLines, Progress};
use crate::terminal::print_line;

/// Time between two writes of the file with the progress, which lies on a file system that many machines share.
const TELL_INTERVAL: Duration = Duration::from_secs(2);

/// Arguments of `exec`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct ExecArgs {
    /// A file with actions, a line each, or the key of a result in the shared store, whose action is then computed again
    #[arg(value_name = "ACTION")]
    pub action: String,
    /// Address of the shared store: file:///FOLDER or s3://BUCKET/PREFIX
    #[arg(long, value_name = "URL")]
    pub store: Option<PathBuf>,
    /// Write here how it ended, whole or not at all
    #[arg(long, value_name = "FILE")]
    pub result: Option<PathBuf>,
    /// Folder for checkpoints and what was fetched, kept until there is a result [default: a temporary one]
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
}

const AFTER_HELP: &str = "\
ACTION may also be the question of a run which backend its jobs have.
Of the inputs only those are fetched that are \
read; a result that is there already stays, and is compared with this one. `marf run --on slurm` writes actions and submits jobs that call this verb.
Exit codes: 0 the result is in the shared store, 1 it could not be made, 10 another marf or another machine must make it (this one \
would make another key of it, or has another backend), 130 stopped at a checkpoint.";

/// `marf exec`: computes an action, and tells how that ended.
pub fn exec(global: &Global, args: &ExecArgs, cancel: &Cancel) -> Result<(), CliError> {
    let remote = Remote::open(&address(args)?, Patience::Patient, trust(&[])?)?;
    let remote = Arc::new(match index_folder() {
        Some(folder) => remote.keeping_indexes(&folder),
        None => remote,
    });
    let reader = Arc::new(Reader::new(Arc::clone(&remote), Wish(cancel.clone())));
    let wanted = Wanted::read(&args.action, reader.as_ref())?;
    let ended = match &wanted.what {
        What::Actions(list) => compute(list, (&remote, reader), global, args, cancel),
        What::Backend(question) => backend_of(question),
    };
    if let Some(path) = &args.result
        && !matches!(ended, Err(CliError::Interrupted))
    {
        let result = JobResult {
            key: wanted.key,
            program: program::PROGRAM.to_owned(),
            fault: ended.as_ref().err().map(fault),
            backend: ended.iter().find_map(|ended| ended.backend.clone()),
            warnings: ended
                .iter()
                .flat_map(|ended| &ended.conflicts)
                .map(in_words)
                .collect(),
        };
        let written = result.write(path);
        written.map_err(|error| CliError::failed(format!("{}: {error}", path.display())))?;
    }
    let ended = ended?;
    ended.conflicts.iter().map(in_words).for_each(warn);
    if let What::Actions(list) = &wanted.what {
        for action in list {
            print_line(&format!("{} {}", action.stage, action.key()));
        }
        print_line(&words(remote.traffic()));
    }
    ended.backend.iter().for_each(|backend| print_line(backend));
    Ok(())
}

/// What is to be done, with the digest of its bytes.
struct Wanted {
    key: Digest,
    what: What,
}

/// What a file for this verb holds.
enum What {
    /// Actions to compute.
    Actions(Vec<Action>),
    /// The question of a run that plans for this machine.
    Backend(BackendQuestion),
}

/// What came of it.
#[derive(Default)]
struct Ended {
    /// Conflicts with results that were there.
    conflicts: Vec<Conflict>,
    /// The backend that was asked for.
    backend: Option<String>,
}

/// Returns the backend of a device of this machine.
fn backend_of(question: &BackendQuestion) -> Result<Ended, CliError> {
    let device: Device = question
        .backend_of
        .parse()
        .map_err(|error: DeviceError| CliError::usage(error.to_string()))?;
    let backend = device
        .opened_id()
        .map_err(|error| CliError::failed(error.to_string()))?;
    Ok(Ended {
        backend,
        ..Ended::default()
    })
}

/// Returns where jobs of this machine keep the indexes of packs: the cache folder of the user; none without one.
fn index_folder() -> Option<PathBuf> {
    let folder = |name: &str| {
        std::env::var_os(name)
            .filter(|path| !path.is_empty())
            .map(PathBuf::from)
    };
    let cache = folder("XDG_CACHE_HOME").or_else(|| Some(folder("HOME")?.join(".cache")));
    Some(cache?.join("marf/indexes"))
}

/// Returns the address of the shared store.
fn address(args: &ExecArgs) -> Result<String, CliError> {
    let given = args.store.as_ref().and_then(|store| store.to_str());
    given.map(str::to_owned).ok_or_else(|| {
        let diagnostic = Diagnostic::new("--store is needed: inputs come from a shared store");
        CliError::Usage(diagnostic.hint("file:///FOLDER or s3://BUCKET/PREFIX"))
    })
}

impl Wanted {
    /// Reads what a file holds, or the action of a key.
    fn read(given: &str, reader: &dyn Upstream) -> Result<Self, CliError> {
        let bytes = match given.parse::<Digest>() {
            Ok(key) => reader
                .blob(&key)
                .map_err(CliError::failed)?
                .filter(|bytes| Digest::of(bytes) == key)
                .ok_or_else(|| CliError::failed(format!("the shared store has no action {}", key.short())))?,
            Err(_) => std::fs::read(given).map_err(|error| CliError::usage(format!("{given}: {error}")))?,
        };
        let key = Digest::of(&bytes);
        if let Some(question) = BackendQuestion::decode(&bytes) {
            let what = What::Backend(question);
            return Ok(Self { key, what });
        }
        let lines = bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
        let list: Result<Vec<Action>, _> = lines.map(Action::decode).collect();
        let list = list.map_err(|error| CliError::usage(format!("{given}: {error}")))?;
        match list.is_empty() {
            true => Err(CliError::usage(format!("{given}: no action"))),
            false => Ok(Self {
                key,
                what: What::Actions(list),
            }),
        }
    }
}

/// Computes actions one after the other and sends their results. Returns the conflicts with results that were there.
fn compute<R: Upstream + 'static>(
    actions: &[Action],
    (remote, reader): (&Remote, Arc<R>),
    global: &Global,
    args: &ExecArgs,
    cancel: &Cancel,
) -> Result<Ended, CliError> {
    let temporary = match args.scratch {
        Some(_) => None,
        None => Some(tempfile::tempdir().map_err(|error| CliError::failed(error.to_string()))?),
    };
    let kept = args.scratch.as_deref();
    let dir = kept
        .or(temporary.as_ref().map(|dir| dir.path()))
        .unwrap_or(Path::new("."));
    let store = open_store(dir, cancel)?.with_upstream(reader);
    let made = actions
        .iter()
        .map(|action| Ok(made(action, &store, global, args, cancel)?.key));
    let keys: Vec<Digest> = made.collect::<Result<_, CliError>>()?;
    let sent = remote.send(&store, &keys, &[], &Wish(cancel.clone()))?;
    drop(store);
    if let Some(dir) = kept {
        // What is left takes space and nothing else.
        let _ = std::fs::remove_dir_all(dir);
    }
    Ok(Ended {
        conflicts: sent.conflicts,
        ..Ended::default()
    })
}

/// Makes the result of an action in its own store.
fn made(
    action: &Action,
    store: &marf_cache::Store,
    global: &Global,
    args: &ExecArgs,
    cancel: &Cancel,
) -> Result<Record, CliError> {
    let listener = Told {
        top: action.stage.clone(),
        file: args.result.as_deref().map(JobProgress::path),
        written: Mutex::default(),
        progress: match global.json {
            true => Progress::Json(JsonLines::new(action.key().short())),
            false => Progress::for_stderr(),
        },
        failure: Mutex::default(),
    };
    let options = Options {
        threads: global.threads,
        program: program::PROGRAM.to_owned(),
        ..Options::default()
    };
    let wanted = (action, params_of(action));
    let made = run_action(wanted, marf_stages::stages(), store, &options, &listener, cancel);
    let failure = listener.failure.into_inner();
    store.take_warnings().into_iter().for_each(warn);
    made.map_err(|error| match error {
        ActionError::Stopped => CliError::Interrupted,
        ActionError::Failed(message) => CliError::Failed(failure.unwrap_or_else(|| Diagnostic::new(message))),
        ActionError::Store(error) => error.into(),
        ActionError::Engine(error) => error.into(),
        ActionError::Graph(error) => error.into(),
        error @ ActionError::Source { .. } => CliError::Elsewhere(
            Diagnostic::new(format!("the action is of {error}"))
                .hint("`marf replay` fetches again, with the pipeline and its archive"),
        ),
        error => CliError::Elsewhere(
            Diagnostic::new(format!("the action is of {error}"))
                .hint("use the marf that planned it, on a machine with the same backend"),
        ),
    })
}

fn fault(error: &CliError) -> Fault {
    let diagnostic = error.diagnostic();
    Fault {
        message: error.message().to_owned(),
        is_elsewhere: matches!(error, CliError::Elsewhere(_)),
        cause: diagnostic.and_then(|diagnostic| diagnostic.cause.clone()),
        hint: diagnostic.and_then(|diagnostic| diagnostic.hint.clone()),
    }
}

/// Shows events, and keeps why it failed.
struct Told {
    progress: Progress,
    failure: Mutex<Option<Diagnostic>>,
    /// Name of the node whose progress is told beside the result, and where; children of it are not.
    top: String,
    file: Option<PathBuf>,
    /// When it was last told.
    written: Mutex<Option<Instant>>,
}

impl Told {
    /// Replaces the file with the progress, if that is due. One that cannot be written costs the job nothing.
    fn tell(&self, progress: &JobProgress) {
        let Some(file) = &self.file else { return };
        let mut written = self.written.lock();
        if written.is_none_or(|written| written.elapsed() >= TELL_INTERVAL) {
            *written = Some(Instant::now());
            let _ = progress.write(file);
        }
    }
}

impl Listener for Told {
    fn on_event(&self, event: &Event) {
        self.progress.on_event(event);
        if let Event::Progress {
            node,
            done,
            total,
            note,
        } = event
            && *node == self.top
        {
            let (done, total, note) = (*done, *total, note.clone());
            self.tell(&JobProgress { done, total, note });
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

/// Tells a shared store whether the user wants to stop.
struct Wish(Cancel);

impl Observer for Wish {
    fn on_progress(&self, _progress: marf_remote::Progress) {}

    fn is_stopped(&self) -> bool {
        self.0.is_set()
    }
}
