//! The shared store of a run.

use std::sync::Arc;
use std::time::Duration;

use marf_cache::{Digest, Record, Store};
use marf_engine::{NodeState, RunRecord, RunSource, SharedResults};
use marf_remote::{Patience, Remote, RemoteError, RemoteRun, Sharing};
use marf_stage::Access;

use crate::error::Error;
use crate::session::Session;
use crate::trust::trust;

/// A run waits at its end so long for what is still being sent, or a tenth of its time if that is longer.
const LEAST_PATIENCE: Duration = Duration::from_secs(10);

/// The shared store as the engine sees it.
#[derive(Debug)]
pub struct Shared(Sharing);

impl SharedResults for Shared {
    fn fetch(&self, keys: &[Digest]) {
        self.0.fetch(keys);
    }

    fn record(&self, key: &Digest) -> Option<Record> {
        self.0.record(key)
    }

    fn offer(&self, key: &Digest) {
        self.0.offer(key);
    }
}

impl Shared {
    /// Opens the shared store that the pipeline of a session names, if it names one and connections are allowed. A store that cannot be
    /// opened is reported, and the run continues without it.
    ///
    /// # Errors
    /// A key that is missing or not valid.
    pub fn open(session: &Session) -> Result<Option<Arc<Self>>, Error> {
        let Some(shared) = &session.shared else {
            return Ok(None);
        };
        let context = &session.context;
        if context.config.access == Access::Offline || session.store.is_read_only() {
            return Ok(None);
        }
        let (stop, feedback) = (context.cancel.clone(), Arc::clone(&context.feedback));
        let remote = Remote::open(
            &shared.url,
            Patience::Impatient,
            trust(shared.trust.as_deref().unwrap_or_default(), context.signing)?,
        );
        let opened = remote.and_then(|remote| {
            let (share, store) = (shared.verify_share, session.store.dir());
            let warn = move |message: String| feedback.warn(&message);
            Sharing::start(remote, share, store, warn, move || stop.is_set())
        });
        let refuse = |error: &RemoteError| {
            let hint = error.hint().map(|hint| format!(" ({hint})")).unwrap_or_default();
            context.warn(format!("{error}{hint}. The run goes on without the shared store"));
        };
        let sharing = opened.inspect_err(refuse).ok();
        Ok(sharing.map(|sharing| Arc::new(Self(sharing))))
    }

    /// Sends a run that is stored, if a node ran in it, and waits a little for pending uploads.
    ///
    /// # Errors
    /// A local store that cannot be read.
    pub fn finish(&self, session: &Session, record: &RunRecord) -> Result<(), Error> {
        let has_run = record.nodes.iter().any(|node| node.state == NodeState::Finished);
        let run = has_run.then(|| remote_run(&session.store, record)).transpose()?;
        let tenth = Duration::try_from_secs_f64(record.seconds / 10.0).unwrap_or(LEAST_PATIENCE);
        self.0.finish(run, tenth.max(LEAST_PATIENCE));
        Ok(())
    }
}

/// Returns a run as it is sent: with the keys of its results, and of the last results of other nodes that the store still has.
///
/// # Errors
/// A run that is not stored or cannot be read.
pub fn remote_run(store: &Store, run: &RunRecord) -> Result<RemoteRun, Error> {
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
        pipeline: match &run.source {
            // Who pulls the newest run of a pipeline gets none that was made from it.
            RunSource::Derived { purpose, .. } => format!("{} ({purpose})", run.pipeline),
            _ => run.pipeline.clone(),
        },
        started_unix_s: run.started_unix_s,
        keys,
        blobs: run.documents.values().map(|document| document.digest).collect(),
        root: String::from_utf8_lossy(&root).into_owned(),
    })
}
