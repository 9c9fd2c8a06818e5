//! A batch system with its shared store: what jobs read is sent there, and what they make is fetched from there.

use std::{
    collections::BTreeSet,
    fmt, fs,
    path::PathBuf,
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use marf_cache::{Digest, Store, StoreError};
use marf_engine::{Needs, Order};
use marf_remote::{Remote, RemoteError};
use marf_stage::{Cancel, StageError};
use parking_lot::Mutex;

use crate::{
    errors::{failed, remote_failed},
    queue::Queue,
    site::{Site, SiteError},
};

/// Longest time until a wish to stop is heard.
const LOOK_INTERVAL: Duration = Duration::from_millis(200);

/// A batch system that computes the nodes of a run.
pub struct Cluster {
    pub(crate) site: Site,
    pub(crate) script: String,
    pub(crate) marf: PathBuf,
    pub(crate) remote: Arc<Remote>,
    pub(crate) queue: Queue,
    /// The backend id of the GPU of the machines of jobs. `None` without a GPU.
    pub(crate) gpu: Option<String>,
    /// File with the stored answer for `gpu`.
    pub(crate) asked: Option<PathBuf>,
    /// When this run began to look at the queue.
    pub(crate) began: Instant,
    /// The part of the run in the shared store. One push at a time.
    shared: Mutex<Shared>,
}

/// What of a run is in the shared store.
#[derive(Default)]
struct Shared {
    /// Keys of results.
    keys: BTreeSet<Digest>,
    /// Their outputs, and inputs that no result consists of.
    blobs: BTreeSet<Digest>,
}

impl fmt::Debug for Cluster {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Cluster")
            .field("site", &self.site)
            .finish_non_exhaustive()
    }
}

impl Cluster {
    /// Returns the batch system of a site, whose shared store is open. If jobs are on a GPU, the caller must ask for its
    /// backend ([`Cluster::ask_backend`]).
    ///
    /// # Errors
    /// Returns an error if a template cannot be read, a folder cannot be made, or the batch system does not answer.
    pub fn new(
        site: Site,
        remote: Arc<Remote>,
        program: PathBuf,
        cancel: &Cancel,
    ) -> Result<Self, SiteError> {
        site.commands
            .list(cancel)
            .map_err(|said| SiteError::Silent { said })?;
        fs::create_dir_all(&site.folder).map_err(|error| SiteError::invalid(&site.folder, error))?;
        Ok(Self {
            script: site.script()?,
            marf: site.marf.clone().unwrap_or(program),
            remote,
            queue: Queue::new(Duration::from_secs_f64(site.poll_s)),
            gpu: None,
            asked: None,
            began: Instant::now(),
            shared: Mutex::default(),
            site,
        })
    }

    /// Sends everything that an action reads to the shared store.
    pub(crate) fn share(&self, order: &Order<'_>) -> Result<(), StageError> {
        let mut shared = self.shared.lock();
        let is_new = |key: &&Digest| !shared.keys.contains(key);
        let new: Vec<Digest> = order.results.iter().filter(is_new).copied().collect();
        let unread = |error: StoreError| failed(order.node, "inputs cannot be read", &error);
        let outputs = outputs_of(order.store, &new).map_err(unread)?;
        // Those that the parent of a child has made for it.
        let inputs = order.action.inputs.values();
        let is_foreign = |blob: &&Digest| !shared.blobs.contains(blob) && !outputs.contains(blob);
        let foreign: Vec<Digest> = inputs.filter(is_foreign).copied().collect();
        if new.is_empty() && foreign.is_empty() {
            return Ok(());
        }
        let blobs = if foreign.is_empty() {
            Vec::new()
        } else {
            order.store.closure(&[], &foreign).map_err(unread)?.blobs
        };
        order.progress.at(0, 0, "inputs go to the shared store");
        let pushed = self
            .remote
            .send(order.store, &new, &blobs, &|| order.cancel.is_set());
        pushed.map_err(|error| remote_failed(order.node, "inputs cannot be shared", error))?;
        shared.keys.extend(new);
        shared.blobs.extend(outputs.into_iter().chain(foreign));
        Ok(())
    }

    /// Fetches the result of an action from the shared store. Returns whether it exists.
    pub(crate) fn fetch(&self, order: &Order<'_>) -> Result<bool, StageError> {
        let fetched = self
            .remote
            .bring(order.store, &[order.key], &|| order.cancel.is_set());
        match fetched {
            Ok(_) => self.note_shared(order).map(|()| true),
            Err(RemoteError::Absent { .. } | RemoteError::Missing { .. }) => Ok(false),
            Err(error) => Err(remote_failed(order.node, "its result cannot be fetched", error)),
        }
    }

    /// Notes that the result of an action is in the shared store.
    pub(crate) fn note_shared(&self, order: &Order<'_>) -> Result<(), StageError> {
        let outputs = outputs_of(order.store, &[order.key])
            .map_err(|error| failed(order.node, "its result cannot be read", &error))?;
        let mut shared = self.shared.lock();
        shared.keys.insert(order.key);
        shared.blobs.extend(outputs);
        Ok(())
    }

    /// Fetches the result that a job has reported. A file system of many machines may show it later than the report, or incomplete.
    pub(crate) fn bring_told(&self, order: &Order<'_>) -> Result<(), StageError> {
        let told = Instant::now();
        loop {
            let late = match self
                .remote
                .bring(order.store, &[order.key], &|| order.cancel.is_set())
            {
                Ok(_) => return Ok(()),
                Err(
                    late @ (RemoteError::Absent { .. }
                    | RemoteError::Missing { .. }
                    | RemoteError::Damaged { .. }),
                ) => late,
                Err(error) => return Err(remote_failed(order.node, "its result cannot be fetched", error)),
            };
            if told.elapsed() >= self.patience() {
                let what = format!(
                    "its job is done, and after {:.0} s the shared store lacks its result",
                    self.site.patience_s
                );
                return Err(failed(order.node, &what, &late)
                    .hint("is `store` of the site file the same place on all machines?"));
            }
            if order.cancel.is_set() {
                return Err(StageError::Cancelled);
            }
            let note = "its job is done, and the shared store does not show its result yet";
            order.progress.at(0, 0, note);
            self.rest(order.cancel);
        }
    }

    /// Returns the memory of a job, MB.
    pub(crate) fn memory_mb(&self, needs: &Needs) -> u64 {
        needs
            .memory_mb
            .map_or(self.site.memory_mb, |peak| peak + peak / 2)
    }

    pub(crate) fn patience(&self) -> Duration {
        Duration::from_secs_f64(self.site.patience_s)
    }

    /// Waits until it is time for another look, or the user wants to stop.
    pub(crate) fn rest(&self, cancel: &Cancel) {
        let mut left = Duration::from_secs_f64(self.site.poll_s);
        while !left.is_zero() && !cancel.is_set() {
            let slice = left.min(LOOK_INTERVAL);
            thread::sleep(slice);
            left -= slice;
        }
    }
}

/// Returns the outputs of the results of keys.
fn outputs_of(store: &Store, keys: &[Digest]) -> Result<BTreeSet<Digest>, StoreError> {
    let mut outputs = BTreeSet::new();
    for key in keys {
        let record = store.record(key)?;
        let of_record = record.iter().flat_map(|record| record.outputs.values());
        outputs.extend(of_record.map(|output| output.digest));
    }
    Ok(outputs)
}
