//! The shared store beside a run.

use std::sync::Arc;
use std::time::Duration;

use marf_cache::{Digest, Record};
use marf_engine::{Cancel, NodeState, RunRecord, SharedResults};
use marf_remote::{RemoteError, Sharing};

use super::args::Global;
use super::cache::remote_run;
use super::error::CliError;
use super::session::{Session, warn};
use super::trust::trust;

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
    /// Opens the shared store that the pipeline of a session names, if it names one and connections are allowed. One that
    /// cannot be opened is told, and the run goes on without it.
    ///
    /// # Errors
    /// A key that is not there or is none.
    pub fn open(session: &Session, global: &Global, cancel: &Cancel) -> Result<Option<Arc<Self>>, CliError> {
        let Some(shared) = &session.shared else {
            return Ok(None);
        };
        if global.offline || session.store.is_read_only() {
            return Ok(None);
        }
        let stop = cancel.clone();
        let opened = Sharing::start(
            &shared.url,
            (trust(&shared.trust)?, shared.verify_share),
            session.store.dir(),
            warn,
            move || stop.is_set(),
        );
        let refuse = |error: &RemoteError| {
            let hint = error.hint().map(|hint| format!(" ({hint})")).unwrap_or_default();
            warn(format!("{error}{hint}; the run goes on without the shared store"));
        };
        let sharing = opened.inspect_err(refuse).ok();
        Ok(sharing.map(|sharing| Arc::new(Self(sharing))))
    }

    /// Sends a run that is stored, if a node ran in it, and waits a little for what is still being sent.
    ///
    /// # Errors
    /// An own store that cannot be read.
    pub fn finish(&self, session: &Session, record: &RunRecord) -> Result<(), CliError> {
        let has_run = record.nodes.iter().any(|node| node.state == NodeState::Finished);
        let run = has_run.then(|| remote_run(&session.store, record)).transpose()?;
        let tenth = Duration::try_from_secs_f64(record.seconds / 10.0).unwrap_or(LEAST_PATIENCE);
        self.0.finish(run, tenth.max(LEAST_PATIENCE));
        Ok(())
    }
}
