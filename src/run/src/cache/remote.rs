//! Runs travel through a shared store, which is collected and verified.

use std::sync::Arc;

use marf_cache::{Digest, Store};
use marf_config as config;
use marf_engine::Cancel;
use marf_remote::{
    FsckOptions, GcOptions, Observer, Patience, Remote, RemoteError, RemoteFsckReport, RemoteGcReport,
    RemoteRun, Traffic, in_words,
};
use serde::Serialize;

use crate::choice::whole_run;
use crate::context::{Context, Feedback};
use crate::error::{Diagnostic, Error};
use crate::session::unnamed;
use crate::shared::remote_run;
use crate::trust::trust;

/// A shared store, and the request that uses it.
pub struct SharedStore<'a> {
    context: &'a Context,
    remote: Remote,
}

/// A run that was sent.
#[derive(Debug, Serialize)]
pub struct PushResult {
    /// Digest of its root.
    pub run: Digest,
    /// Its number here.
    #[serde(skip)]
    pub number: u64,
    /// Results that were sent.
    pub results: u64,
    /// Results that were there.
    pub known_results: u64,
    /// Blobs that were sent.
    pub blobs: u64,
    /// Their bytes.
    pub blob_bytes: u64,
    /// Packs that were sent.
    pub packs: u64,
    /// Keys for which another result was there first.
    pub conflicts: usize,
    /// What moved.
    pub traffic: Traffic,
}

/// A run that was fetched.
#[derive(Debug, Serialize)]
pub struct PullResult {
    /// Digest of its root.
    pub run: Digest,
    /// Its number here.
    pub number: u64,
    /// Name of its pipeline.
    pub pipeline: String,
    /// Results that were fetched.
    pub results: u64,
    /// Results that were here.
    pub known_results: u64,
    /// Blobs that were fetched.
    pub blobs: u64,
    /// Their bytes.
    pub blob_bytes: u64,
    /// What moved.
    pub traffic: Traffic,
}

impl<'a> SharedStore<'a> {
    /// Opens the shared store of an address, or else that of the pipeline.
    ///
    /// # Errors
    /// No address, keys that are not there, a store that cannot be opened.
    pub fn open(context: &'a Context, url: Option<&str>) -> Result<Self, Error> {
        let remote = open(context, url)?;
        Ok(Self { context, remote })
    }

    /// Returns its address.
    pub fn place(&self) -> String {
        self.remote.place().to_owned()
    }

    /// Returns the traffic so far.
    pub fn traffic(&self) -> Traffic {
        self.remote.traffic()
    }

    /// Sends a run of a store, by default the newest whole one.
    ///
    /// # Errors
    /// A run that is not there, a store that cannot be read or written.
    pub fn push(&self, store: &Store, number: Option<u64>) -> Result<PushResult, Error> {
        let run = whole_run(self.context, store, number)?;
        let sent = remote_run(store, &run)?;
        let pushed = self.remote.push(store, &sent, &self.transfer("push"))?;
        pushed
            .conflicts
            .iter()
            .map(in_words)
            .for_each(self.context.warnings());
        Ok(PushResult {
            run: Digest::from_content(sent.root.as_bytes()),
            number: run.number,
            results: pushed.records,
            known_results: pushed.known_records,
            blobs: pushed.blobs,
            blob_bytes: pushed.blob_bytes,
            packs: pushed.packs,
            conflicts: pushed.conflicts.len(),
            traffic: self.remote.traffic(),
        })
    }

    /// Fetches a run by the first digits of its digest, by default the newest of the pipeline.
    ///
    /// # Errors
    /// A run that is not there, a store that cannot be read or written.
    pub fn pull(&self, store: &Store, digits: Option<&str>) -> Result<PullResult, Error> {
        let (remote, transfer) = (&self.remote, self.transfer("pull"));
        let (root, run) = match digits {
            Some(digits) => {
                let root = named(remote, digits, &transfer)?;
                (root, remote.run(&root, &transfer)?)
            }
            None => newest(self.context, remote, &transfer)?,
        };
        let pulled = remote.pull(store, &run, &transfer)?;
        Ok(PullResult {
            run: root,
            number: add_run(self.context, store, &run, &root)?,
            pipeline: run.pipeline,
            results: pulled.records,
            known_results: pulled.known_records,
            blobs: pulled.blobs,
            blob_bytes: pulled.blob_bytes,
            traffic: remote.traffic(),
        })
    }

    /// Removes what no kept run needs.
    ///
    /// # Errors
    /// A store that cannot be read or written.
    pub fn gc(&self, options: GcOptions) -> Result<RemoteGcReport, Error> {
        Ok(self.remote.gc(options, &self.transfer("gc"))?)
    }

    /// Verifies the store.
    ///
    /// # Errors
    /// A store that cannot be read or written.
    pub fn fsck(&self, options: FsckOptions) -> Result<RemoteFsckReport, Error> {
        Ok(self.remote.fsck(options, &self.transfer("fsck"))?)
    }

    fn transfer(&self, name: &'static str) -> Transfer {
        Transfer {
            name,
            feedback: Arc::clone(&self.context.feedback),
            cancel: self.context.cancel.clone(),
        }
    }
}

/// Opens the shared store of this address, or else that of the pipeline.
fn open(context: &Context, url: Option<&str>) -> Result<Remote, Error> {
    // The trusted writers are those of the pipeline, if there is one, whatever the address.
    let shared = if url.is_some() && !context.file.exists() {
        None
    } else {
        config::load(&context.file, &context.sets, &context.config)?
            .pipeline
            .shared
    };
    let (configured, writers) = match shared {
        Some(shared) => (Some(shared.url), shared.trust),
        None => (None, None),
    };
    let url = url.map(str::to_owned).or(configured).ok_or_else(|| {
        Error::Usage(Diagnostic::new("no shared store is named").hint(
            "name one with --remote, or in pipeline.toml: `[store]` with `remote = \"s3://BUCKET/PREFIX\"`",
        ))
    })?;
    let trust = trust(&writers.unwrap_or_default(), context.signing)?;
    Ok(Remote::open(&url, Patience::Patient, trust)?)
}

/// Returns the run whose digest begins with these digits.
fn named(remote: &Remote, digits: &str, transfer: &Transfer) -> Result<Digest, Error> {
    let runs = remote.runs(None, transfer)?;
    let mut found = runs
        .iter()
        .filter(|(_, root)| root.to_string().starts_with(digits));
    match (found.next(), found.next()) {
        (Some((_, root)), None) => Ok(*root),
        (Some(_), Some(_)) => Err(Error::usage(format!(
            "--run {digits}: several runs begin with these digits. Write more digits"
        ))),
        (None, _) => Err(no_run(remote, &format!("no run {digits}"), &runs)),
    }
}

/// Returns the newest run of the pipeline of the arguments. Runs of untrusted writers are reported and skipped.
fn newest(context: &Context, remote: &Remote, transfer: &Transfer) -> Result<(Digest, RemoteRun), Error> {
    let loaded = config::load(&context.file, &context.sets, &context.config)?;
    let name = loaded.pipeline.name.unwrap_or_else(|| unnamed(&context.file));
    let mut strange = None;
    for (_, root) in remote.runs(Some(&name), transfer)? {
        match remote.run(&root, transfer) {
            Err(error @ RemoteError::Untrusted { .. }) => {
                context.warn(error.to_string());
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

fn no_run(remote: &Remote, what: &str, runs: &[(u64, Digest)]) -> Error {
    const SHOWN: usize = 5;
    let newest: Vec<String> = runs.iter().take(SHOWN).map(|(_, root)| root.short()).collect();
    let hint = if newest.is_empty() {
        "`marf cache push` sends one".to_owned()
    } else {
        format!(
            "name one with --run. The newest of all pipelines are {}",
            newest.join(", ")
        )
    };
    Error::Failed(Diagnostic::new(format!("{} has {what}", remote.place())).hint(hint))
}

/// Adds a run to the store and returns its number. A run that is there already keeps its number.
fn add_run(context: &Context, store: &Store, run: &RemoteRun, root: &Digest) -> Result<u64, Error> {
    let known = marf_engine::runs(store, context.warnings())?;
    match known.iter().find(|known| known.root == Some(*root)) {
        Some(known) => Ok(known.number),
        None => Ok(store.put_run(run.root.as_bytes())?),
    }
}

/// Reports the progress of a transfer, and looks whether the user wants to stop.
struct Transfer {
    name: &'static str,
    feedback: Arc<dyn Feedback>,
    cancel: Cancel,
}

impl Observer for Transfer {
    fn on_progress(&self, moved: marf_remote::Progress) {
        self.feedback.on_transfer(self.name, moved);
    }

    fn is_stopped(&self) -> bool {
        self.cancel.is_set()
    }
}
