//! `marf cache push` and `pull`, and `gc` and `fsck` with `--remote`: runs travel through a shared store.

use marf_cache::{Digest, Store};
use marf_engine::{Cancel, Event, Listener, RunRecord};
use marf_remote::{
    FsckOptions, GcOptions, Observer, Patience, Remote, RemoteError, RemoteRun, Traffic, in_words,
};
use serde_json::json;

use super::args::{FsckArgs, GcArgs, PullArgs, PushArgs};
use super::{grace, megabytes};
use crate::cli::args::Global;
use crate::cli::error::{CliError, Diagnostic};
use crate::cli::output::print_json;
use crate::cli::session::{last_of, unnamed, warn};
use crate::cli::trust::trust;
use marf_config as config;
use crate::cli::progress::Progress;
use crate::terminal::{eprint_line, print_line};

/// `marf cache push`: sends a run.
pub fn push(global: &Global, store: &Store, args: &PushArgs, cancel: &Cancel) -> Result<(), CliError> {
    let remote = open(global, args.remote.as_deref())?;
    let run = match args.run {
        Some(number) => marf_engine::run_of(store, number)?,
        None => last_of(&marf_engine::runs(store, warn)?)
            .cloned()
            .ok_or_else(|| {
                CliError::Failed(Diagnostic::new("there is no run yet").hint("`marf run` makes one"))
            })?,
    };
    let sent = remote_run(store, &run)?;
    let pushed = remote.push(store, &sent, &Transfer::new(global, "push", cancel))?;
    pushed
        .conflicts
        .iter()
        .for_each(|conflict| warn(in_words(conflict)));
    let (root, traffic) = (Digest::of(sent.root.as_bytes()), remote.traffic());
    if global.json {
        return print_json(&json!({
            "run": root, "results": pushed.records, "known_results": pushed.known_records, "blobs": pushed.blobs,
            "blob_bytes": pushed.blob_bytes, "packs": pushed.packs, "conflicts": pushed.conflicts.len(),
            "traffic": traffic,
        }));
    }
    print_line(&format!(
        "pushed run {} ({}): {} results, {} were there; {} blobs, {}, {} packs; {}",
        run.number,
        root.short(),
        pushed.records,
        pushed.known_records,
        pushed.blobs,
        megabytes(pushed.blob_bytes),
        pushed.packs,
        words(traffic),
    ));
    Ok(())
}

/// `marf cache pull`: fetches a run.
pub fn pull(global: &Global, store: &Store, args: &PullArgs, cancel: &Cancel) -> Result<(), CliError> {
    let remote = open(global, args.remote.as_deref())?;
    let transfer = Transfer::new(global, "pull", cancel);
    let (root, run) = match &args.run {
        Some(digits) => {
            let root = named(&remote, digits, &transfer)?;
            (root, remote.run(&root, &transfer)?)
        }
        None => newest(global, &remote, &transfer)?,
    };
    let pulled = remote.pull(store, &run, &transfer)?;
    let number = add_run(store, &run, &root)?;
    let traffic = remote.traffic();
    if global.json {
        return print_json(&json!({
            "run": root, "number": number, "pipeline": run.pipeline, "results": pulled.records,
            "known_results": pulled.known_records, "blobs": pulled.blobs, "blob_bytes": pulled.blob_bytes,
            "traffic": traffic,
        }));
    }
    print_line(&format!(
        "pulled run {} of `{}` as run {number}: {} results, {} were here; {} blobs, {}; {}",
        root.short(),
        run.pipeline,
        pulled.records,
        pulled.known_records,
        pulled.blobs,
        megabytes(pulled.blob_bytes),
        words(traffic),
    ));
    Ok(())
}

/// `marf cache gc --remote`: removes what no kept run of the shared store needs.
pub fn gc(global: &Global, args: &GcArgs, cancel: &Cancel) -> Result<(), CliError> {
    let remote = open(global, args.remote.as_ref().and_then(Option::as_deref))?;
    let options = GcOptions {
        keep_last: args.keep_last,
        grace: grace(&args.grace)?,
        dry_run: args.dry_run,
    };
    let done = remote.gc(options, &Transfer::new(global, "gc", cancel))?;
    if global.json {
        return print_json(&json!({"dry_run": args.dry_run, "collected": done, "traffic": remote.traffic()}));
    }
    let would = if args.dry_run { "would remove" } else { "removed" };
    print_line(&format!(
        "{would} {} runs, {} records, {} large blobs, {} packs: {}; kept {}, of it {} packs written anew; {}",
        done.runs,
        done.records,
        done.blobs,
        done.packs,
        megabytes(done.removed_bytes),
        megabytes(done.kept_bytes),
        done.new_packs,
        words(remote.traffic()),
    ));
    if done.missing > 0 {
        warn(format!(
            "{} results that kept runs name are missing; `marf cache fsck --remote` names what lacks them",
            done.missing
        ));
    }
    Ok(())
}

/// `marf cache fsck --remote`: verifies the shared store.
pub fn fsck(global: &Global, args: &FsckArgs, cancel: &Cancel) -> Result<(), CliError> {
    let remote = open(global, args.remote.as_ref().and_then(Option::as_deref))?;
    let options = FsckOptions {
        read_data: args.read_data,
        repair: args.repair,
    };
    let checked = remote.fsck(options, &Transfer::new(global, "fsck", cancel))?;
    if global.json {
        print_json(&checked)?;
    } else {
        for fault in &checked.faults {
            print_line(&format!("{}: {}", fault.object, fault.what));
        }
        print_line(&format!(
            "{} blobs, {} records, {} runs; {} read; {} faults",
            checked.blobs,
            checked.records,
            checked.runs,
            megabytes(checked.read_bytes),
            checked.faults.len()
        ));
    }
    match (checked.faults.is_empty(), checked.is_repaired) {
        (true, _) => Ok(()),
        (false, true) => {
            eprint_line("repaired: what was damaged is removed, with what names it; the next push sends it again");
            Ok(())
        }
        (false, false) => Err(CliError::Failed(
            Diagnostic::new(format!("{} has {} faults", remote.place(), checked.faults.len())).hint(
                "`marf cache fsck --remote --repair` removes them; `marf cache push` from a machine that has the results sends them again",
            ),
        )),
    }
}

/// Opens the shared store of this address, or else that of the pipeline.
fn open(global: &Global, url: Option<&str>) -> Result<Remote, CliError> {
    // A pipeline that is there tells whom to believe, whatever the address.
    let shared = match url.is_some() && !global.file.exists() {
        true => None,
        false => {
            config::load(&global.file, &global.sets, &global.options())?
                .pipeline
                .shared
        }
    };
    let (configured, writers) = shared.map(|shared| (shared.url, shared.trust)).unzip();
    let url = url.map(str::to_owned).or(configured).ok_or_else(|| {
        CliError::Usage(Diagnostic::new("no shared store is named").hint(
            "name one with --remote, or in pipeline.toml: `[store]` with `remote = \"s3://BUCKET/PREFIX\"`",
        ))
    })?;
    let trust = trust(&writers.unwrap_or_default())?;
    Ok(Remote::open(&url, Patience::Patient, trust)?)
}

/// Returns a run as it travels: with the keys of its results, and of the last ones of other nodes as far as they are kept.
///
/// # Errors
/// A run that is not stored or cannot be read.
pub fn remote_run(store: &Store, run: &RunRecord) -> Result<RemoteRun, CliError> {
    let root = store.run(run.number)?;
    let good = run.nodes.iter().filter(|node| node.state.is_good());
    let mut keys: Vec<Digest> = good.filter_map(|node| node.key).collect();
    for key in run.latest.values() {
        if store.hit(key)?.is_some() {
            keys.push(*key);
        }
    }
    keys.sort_unstable();
    keys.dedup();
    Ok(RemoteRun {
        pipeline: run.pipeline.clone(),
        started_unix_s: run.started_unix_s,
        keys,
        blobs: run.documents.values().map(|document| document.digest).collect(),
        root: String::from_utf8_lossy(&root).into_owned(),
    })
}

/// Returns the run whose digest begins with these digits.
fn named(remote: &Remote, digits: &str, transfer: &Transfer<'_>) -> Result<Digest, CliError> {
    let runs = remote.runs(None, transfer)?;
    let mut found = runs
        .iter()
        .filter(|(_, root)| root.to_string().starts_with(digits));
    match (found.next(), found.next()) {
        (Some((_, root)), None) => Ok(*root),
        (Some(_), Some(_)) => Err(CliError::usage(format!(
            "--run {digits}: several runs begin so; write more digits"
        ))),
        (None, _) => Err(no_run(remote, &format!("no run {digits}"), &runs)),
    }
}

/// Returns the newest run of the pipeline of the arguments; those of strangers are told and passed over.
fn newest(
    global: &Global,
    remote: &Remote,
    transfer: &Transfer<'_>,
) -> Result<(Digest, RemoteRun), CliError> {
    let loaded = config::load(&global.file, &global.sets, &global.options())?;
    let name = loaded.pipeline.name.unwrap_or_else(|| unnamed(&global.file));
    let mut strange = None;
    for (_, root) in remote.runs(Some(&name), transfer)? {
        match remote.run(&root, transfer) {
            Err(error @ RemoteError::Untrusted { .. }) => {
                warn(error.to_string());
                strange = Some(error);
            }
            run => return Ok((root, run?)),
        }
    }
    if let Some(strange) = strange {
        return Err(strange.into());
    }
    let all = remote.runs(None, transfer)?;
    Err(no_run(remote, &format!("no run of the pipeline `{name}`"), &all))
}

fn no_run(remote: &Remote, what: &str, runs: &[(u64, Digest)]) -> CliError {
    const SHOWN: usize = 5;
    let newest: Vec<String> = runs.iter().take(SHOWN).map(|(_, root)| root.short()).collect();
    let hint = match newest.is_empty() {
        true => "`marf cache push` sends one".to_owned(),
        false => format!(
            "name one with --run; the newest of all pipelines are {}",
            newest.join(", ")
        ),
    };
    CliError::Failed(Diagnostic::new(format!("{} has {what}", remote.place())).hint(hint))
}

/// Adds a run to the store and returns its number; one that is there keeps its own.
fn add_run(store: &Store, run: &RemoteRun, root: &Digest) -> Result<u64, CliError> {
    let known = marf_engine::runs(store, warn)?;
    match known.iter().find(|known| known.root == Some(*root)) {
        Some(known) => Ok(known.number),
        None => Ok(store.put_run(run.root.as_bytes())?),
    }
}

pub fn words(traffic: Traffic) -> String {
    format!(
        "{} requests, {} sent, {} received",
        traffic.requests,
        megabytes(traffic.sent_bytes),
        megabytes(traffic.received_bytes)
    )
}

/// Prints the progress of a push or a pull, with the remaining time, and looks whether the user wants to stop.
struct Transfer<'a> {
    name: &'static str,
    progress: Option<Progress>,
    cancel: &'a Cancel,
}

impl<'a> Transfer<'a> {
    fn new(global: &Global, name: &'static str, cancel: &'a Cancel) -> Self {
        Self {
            name,
            progress: (!global.json).then(Progress::for_stderr),
            cancel,
        }
    }
}

impl Observer for Transfer<'_> {
    fn on_progress(&self, moved: marf_remote::Progress) {
        if let Some(progress) = &self.progress {
            progress.on_event(&Event::Progress {
                node: self.name.to_owned(),
                done: moved.done_bytes / 1_000,
                total: moved.total_bytes / 1_000,
                note: "KB".to_owned(),
            });
        }
    }

    fn is_stopped(&self) -> bool {
        self.cancel.is_set()
    }
}

impl From<RemoteError> for CliError {
    fn from(error: RemoteError) -> Self {
        let diagnostic = Diagnostic {
            message: error.to_string(),
            cause: None,
            hint: error.hint(),
        };
        match error {
            RemoteError::Stopped => Self::Interrupted,
            RemoteError::Store(error) => error.into(),
            RemoteError::BadUrl { .. } | RemoteError::NoCredentials { .. } => Self::Usage(diagnostic),
            RemoteError::Newer { .. } => Self::Newer(diagnostic),
            RemoteError::Busy { .. } => Self::Locked(diagnostic),
            _ => Self::Failed(diagnostic),
        }
    }
}
