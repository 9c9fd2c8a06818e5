//! A job: takes the lease on a key, looks the key up again, runs the stage, checks and stores its outputs.

use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
    sync::Arc,
    time::{Instant, SystemTime},
};

use marf_cache::{
    Digest, Output, Record, RunMetadata, StoreError,
    file::{FileKind, Links, read_text},
};
use marf_stage::{Checkpoints, Ctx, NodeSpec, Outputs, Stage, StageDef, StageError, Work};

use super::{context::RunContext, task::RunInputs};
use crate::{
    errors::{contract_violation, panicked},
    event::{Event, NodeProgress},
    executor::{Order, OtherMachines},
    key::{Key, node_key},
    listing::SourceListing,
    lookup::{Lookup, look_up},
    shared::fetch_lacking,
    stage_io::{FileCheckpoints, Lease, StoreBlobs, StoreMemos},
    work::{
        BlobCheck, PartedOutputs, StageOutcome, StageRun, after_round, execute, put_action, put_needs,
        put_parts, with_lengths,
    },
};

/// Stack of a worker thread: decoders and solvers recurse.
pub(super) const STACK_BYTES: usize = 8 << 20;

/// A step of a node's work, on a thread of its own.
pub(super) struct Job<'a> {
    pub(super) context: RunContext<'a>,
    pub(super) node: String,
    pub(super) def: StageDef,
    pub(super) bound: Arc<dyn Stage>,
    pub(super) prepared: RunInputs,
    pub(super) step: Step,
    pub(super) check: BlobCheck,
    pub(super) threads: usize,
    pub(super) began: Instant,
    /// The other machines that compute it. Absent if it is computed here.
    pub(super) elsewhere: Option<OtherMachines<'a>>,
}

/// Which step of a node's work.
pub(super) enum Step {
    /// The first step, and the only one of a node without children.
    Start,
    /// A further round of children, or the reduction of their outputs. It has the outputs of all children so far, and their keys by name.
    AfterRound(Vec<Outputs>, BTreeMap<String, Digest>),
}

/// The result of a job.
pub(super) enum JobOutput {
    /// A result that is in the store by now.
    Reused(Box<Record>),
    /// A result of its own.
    Finished(Box<Record>),
    /// Child nodes that must run first.
    Expanded(Vec<NodeSpec>),
}

/// Why a job failed.
pub(super) enum JobError {
    Stage(StageError),
    Store(StoreError),
}

impl From<StoreError> for JobError {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}

impl From<StageError> for JobError {
    fn from(error: StageError) -> Self {
        Self::Stage(error)
    }
}

impl Job<'_> {
    /// Does the work. The result is in the store when this returns.
    pub(super) fn execute(self) -> Result<JobOutput, JobError> {
        // Children take leases of their own. Their parent holds none while it waits for them.
        let _lease = match (self.bound.work(), &self.step) {
            (Work::Expand(_), Step::Start) => None,
            _ => Some(self.lease()?),
        };
        if self.check == BlobCheck::Outputs
            && let Some(record) = self.made_elsewhere()?
        {
            return Ok(JobOutput::Reused(record));
        }
        if matches!(self.step, Step::Start) {
            self.context.listener.on_event(&Event::WillRun {
                node: self.node.clone(),
                reason: self.prepared.reason.clone(),
                device: self.device(),
            });
        }
        match &self.elsewhere {
            Some(elsewhere) => self.run_elsewhere(elsewhere),
            None => self.run(),
        }
    }

    /// Has the work done by another machine.
    fn run_elsewhere(&self, elsewhere: &OtherMachines<'_>) -> Result<JobOutput, JobError> {
        let (store, key) = (self.context.store, &self.prepared.key);
        put_action(store, key)?;
        store.commit()?;
        elsewhere.executor.execute(&Order {
            node: &self.node,
            key: key.digest,
            action: &key.action,
            needs: elsewhere.needs,
            results: &elsewhere.results,
            store,
            progress: &NodeProgress::new(&self.node, self.context.listener),
            cancel: self.context.cancel,
        })?;
        self.report_conflicts();
        match look_up(store, &key.digest)? {
            Lookup::Hit(record) => Ok(JobOutput::Finished(record)),
            Lookup::Miss | Lookup::MissingOutput(_) => {
                let error = StageError::new("the other machine reports success, but it stored no result");
                Err(error.into())
            }
        }
    }

    /// Returns the result if another process of this machine, or another machine, has made it.
    fn made_elsewhere(&self) -> Result<Option<Box<Record>>, JobError> {
        let (store, key) = (self.context.store, self.prepared.key.digest);
        if matches!(self.step, Step::Start) {
            fetch_lacking(self.context.shared, store, std::iter::once(key))?;
        }
        Ok(match look_up(store, &key)? {
            Lookup::Hit(record) => Some(record),
            Lookup::MissingOutput(_) | Lookup::Miss => None,
        })
    }

    /// Waits for the lease on the key.
    fn lease(&self) -> Result<Lease, StageError> {
        let busy = || self.warn("waiting for another process that computes the same result".to_owned());
        Lease::take(
            self.context.store.dir(),
            &self.prepared.key.digest,
            self.context.cancel,
            busy,
        )
    }

    fn warn(&self, message: String) {
        let node = Some(self.node.clone());
        self.context.listener.on_event(&Event::Warning { node, message });
    }

    fn run(&self) -> Result<JobOutput, JobError> {
        let key = self.prepared.key.digest;
        if self.prepared.key.action.backend != self.bound.backend_id() {
            let device = self.device();
            let message = format!("its key is of {device}, which is not here, and no other machine takes it");
            return Err(contract_violation(message).into());
        }
        let checkpoints = FileCheckpoints::new(self.context.store, &key, &self.node, self.context.listener);
        let metadata = self.metadata();
        let blobs = StoreBlobs::new(self.context.store);
        let progress = NodeProgress::new(&self.node, self.context.listener);
        let produced = self.produce(&blobs, &checkpoints, &metadata, &progress);
        match produced.map_err(|error| self.attribute(error))? {
            StageOutcome::Children(specs) => Ok(JobOutput::Expanded(specs)),
            StageOutcome::Outputs(outputs, listed) => {
                let key = self.final_key(listed)?;
                let metadata = RunMetadata {
                    parts_s: progress.parts_s(),
                    ..metadata
                };
                let record = self.store_record(&key, outputs, blobs, metadata)?;
                checkpoints.remove();
                if let Some(shared) = self.context.shared {
                    shared.offer(&record.key);
                }
                Ok(JobOutput::Finished(record))
            }
        }
    }

    /// Attributes an error to the store if the store cannot be written either (a full disk, a lock).
    fn attribute(&self, error: StageError) -> JobError {
        match &error {
            StageError::Blob(blob) if blob.lost.is_none() => match self.context.store.commit() {
                Err(store_error) => JobError::Store(store_error),
                Ok(()) => JobError::Stage(error),
            },
            _ => JobError::Stage(error),
        }
    }

    /// Runs the stage on the threads of the job.
    fn produce(
        &self,
        blobs: &StoreBlobs<'_>,
        checkpoints: &dyn Checkpoints,
        metadata: &RunMetadata,
        progress: &NodeProgress<'_>,
    ) -> Result<StageOutcome, StageError> {
        let key = &self.prepared.key;
        let memos = StoreMemos::new(self.context.store, key.digest, &self.node, self.context.listener);
        let stage: &dyn Stage = self.bound.as_ref();
        let scratch = self.context.store.scratch();
        let ctx = Ctx {
            blobs,
            cancel: self.context.cancel,
            progress,
            checkpoints,
            memos: &memos,
            scratch: &scratch,
            threads: self.threads,
            began: self.context.began,
        };
        let run = StageRun {
            store: self.context.store,
            ctx,
            def: &self.def,
            stage,
            key,
            inputs: &self.prepared.inputs,
            listed: self.prepared.listed.as_ref(),
            check: self.check,
            shared: self.context.shared,
            metadata,
            warn: &|message| self.warn(message.to_owned()),
        };
        let work = || match &self.step {
            Step::Start => execute(&run),
            Step::AfterRound(done, _) => after_round(&run, done),
        };
        on_threads(self.threads, work)
    }

    /// Returns the key of the result: of a source that of the listing it has found true.
    fn final_key(&self, listed: Option<SourceListing>) -> Result<Key, StageError> {
        let Some(listed) = listed else {
            return Ok(self.prepared.key.clone());
        };
        self.context.graph.keep_listed(&self.node, &listed);
        let mut inputs = self.prepared.inputs.clone();
        inputs.0.extend(listed.inputs.0);
        let (graph, executor) = (self.context.graph, self.context.executor);
        node_key(&graph.table, executor, &self.def, self.bound.as_ref(), &inputs)
    }

    /// Checks and stores the outputs, and returns the record that the store keeps for the key.
    fn store_record(
        &self,
        key: &Key,
        parted: PartedOutputs,
        blobs: StoreBlobs<'_>,
        metadata: RunMetadata,
    ) -> Result<Box<Record>, JobError> {
        self.check_names(&parted.outputs)?;
        let store = self.context.store;
        let parts = if parted.parts.is_empty() {
            None
        } else {
            Some(put_parts(store, &parted.parts)?)
        };
        put_action(store, key)?;
        let record = Record {
            key: key.digest,
            stage: self.def.name.to_owned(),
            needs: put_needs(store, blobs.take_stored(), &parted.outputs)?,
            outputs: with_lengths(store, parted.outputs)?,
            parts,
            children: match &self.step {
                Step::Start => BTreeMap::new(),
                Step::AfterRound(_, keys) => keys.clone(),
            },
            origins: None,
            metadata: RunMetadata {
                seconds: self.began.elapsed().as_secs_f64(),
                peak_mb: peak_mb(),
                counts: parted.counts,
                ..metadata
            },
        };
        store.put_record(record.clone());
        store.commit()?;
        self.report_conflicts();
        let counts = record.metadata.counts.clone();
        let mut kept = store.hit(&record.key)?.unwrap_or(record);
        kept.metadata.counts = counts;
        Ok(Box::new(kept))
    }

    /// Checks the names of the outputs against those that the stage declares.
    fn check_names(&self, outputs: &Outputs) -> Result<(), StageError> {
        let declared = self.def.outputs;
        // A name that ends with `/` is a family of any number.
        let is_family = |name: &str| name.ends_with('/');
        let covers = |declared: &&str, name: &str| {
            *declared == name || (is_family(declared) && name.starts_with(*declared))
        };
        let mut wanted = declared.iter().filter(|name| !is_family(name));
        if let Some(absent) = wanted.find(|&&name| !outputs.contains_key(name)) {
            return Err(contract_violation(format!("its output `{absent}` did not come")));
        }
        let known = |name: &str| declared.iter().any(|declared| covers(declared, name));
        match outputs.keys().find(|name| !known(name)) {
            Some(foreign) => Err(contract_violation(format!(
                "its output `{foreign}` is not declared"
            ))),
            None => Ok(()),
        }
    }

    /// Warns of conflicts, also those of other nodes, because a write batch has records of several nodes.
    fn report_conflicts(&self) {
        for conflict in self.context.store.take_conflicts() {
            let digests = |outputs: &BTreeMap<String, Output>| {
                let outputs = outputs.iter();
                let texts = outputs.map(|(name, output)| format!("{name} {}", output.digest.short()));
                texts.collect::<Vec<_>>().join(", ")
            };
            self.warn(format!(
                "stage `{}` gave two results for key {}: {} is kept, {} is not",
                conflict.stage,
                conflict.key.short(),
                digests(&conflict.kept),
                digests(&conflict.refused),
            ));
        }
    }

    /// Returns the name of the device that computes the node.
    fn device(&self) -> String {
        let backend = &self.prepared.key.action.backend;
        backend.clone().unwrap_or_else(|| "cpu".to_owned())
    }

    /// Returns the metadata of a run that starts now.
    fn metadata(&self) -> RunMetadata {
        RunMetadata {
            seconds: 0.0,
            peak_mb: 0,
            started_unix_s: unix_seconds(),
            device: self.device(),
            program: self.context.options.program.clone(),
            counts: BTreeMap::new(),
            parts_s: BTreeMap::new(),
        }
    }
}

/// Runs `work` in a pool of that many threads. A panic becomes an error.
fn on_threads(
    threads: usize,
    work: impl Fn() -> Result<StageOutcome, StageError> + Send,
) -> Result<StageOutcome, StageError> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .stack_size(STACK_BYTES)
        .build()
        .map_err(|error| StageError::new(format!("{threads} threads cannot be started: {error}")))?;
    pool.install(|| catch_unwind(AssertUnwindSafe(work)))
        .unwrap_or_else(|payload| Err(panicked(payload.as_ref())))
}

/// Returns the time of the clock in seconds since 1970.
pub(super) fn unix_seconds() -> u64 {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    since.map_or(0, |since| since.as_secs())
}

/// Returns the peak memory of this program in MB, or 0 if the system does not report it.
fn peak_mb() -> u64 {
    let status = Path::new("/proc/self/status");
    let status = read_text(status, FileKind::Settings, Links::Refused).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kb = line.and_then(|line| line.trim().trim_end_matches("kB").trim().parse::<u64>().ok());
    kb.unwrap_or(0) / 1024
}
