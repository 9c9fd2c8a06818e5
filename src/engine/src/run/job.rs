//! One piece of work on a thread of its own: lease, look again, run, check, store.

use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
    time::{Instant, SystemTime},
};

use marf_cache::{Digest, Output, Record, RunMetadata, StoreError};
use marf_stage::{Checkpoints, Ctx, NodeSpec, Outputs, Stage, StageDef, StageError, Work};

use super::{Site, task::Order};
use crate::{
    Event,
    bench::{FileCheckpoints, Lease, StoreBlobs, StoreMemos},
    event::NodeProgress,
    lookup::{Found, look_up},
    photos::bug,
    plan::panicked,
    work::{Check, Counts, Job, Produced, perform, reduce, sized},
};

/// Stack of a worker thread: decoders and solvers recurse.
const STACK_BYTES: usize = 8 << 20;

pub(super) struct Shift<'a> {
    pub(super) site: Site<'a>,
    pub(super) node: String,
    pub(super) def: StageDef,
    pub(super) bound: Arc<dyn Stage>,
    pub(super) order: Order,
    pub(super) step: Step,
    pub(super) check: Check,
    pub(super) threads: usize,
    pub(super) began: Instant,
}

/// Which half of a node's work.
pub(super) enum Step {
    Start,
    /// The children have these outputs, and these keys by name.
    Reduce(Vec<Outputs>, BTreeMap<String, Digest>),
}

pub(super) enum Done {
    Reused(Box<Record>),
    Finished(Box<Record>, Counts),
    Expanded(Vec<NodeSpec>),
}

pub(super) enum Fault {
    Stage(StageError),
    Store(StoreError),
}

impl From<StoreError> for Fault {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}

impl From<StageError> for Fault {
    fn from(error: StageError) -> Self {
        Self::Stage(error)
    }
}

impl Shift<'_> {
    pub(super) fn work(self) -> Result<Done, Fault> {
        if matches!(self.step, Step::Reduce(..)) {
            return self.run();
        }
        // Children take leases of their own; one that waits for them must not hold any.
        let _lease = match self.bound.work() {
            Work::Expand(_) => None,
            _ => Some(self.lease()?),
        };
        if self.check == Check::Names
            && let Found::Hit(record) = look_up(self.site.store, &self.order.key.digest)?
        {
            return Ok(Done::Reused(record));
        }
        self.site.listener.on_event(&Event::WillRun {
            node: self.node.clone(),
            reason: self.order.reason.clone(),
            device: self.device(),
        });
        self.run()
    }

    fn lease(&self) -> Result<Lease, StageError> {
        let busy = || self.warn("the same result is being made elsewhere; waiting for it".to_owned());
        Lease::take(
            self.site.store.dir(),
            &self.order.key.digest,
            self.site.cancel,
            busy,
        )
    }

    fn warn(&self, message: String) {
        let node = Some(self.node.clone());
        self.site.listener.on_event(&Event::Warning { node, message });
    }

    fn run(&self) -> Result<Done, Fault> {
        let key = self.order.key.digest;
        let checkpoints = FileCheckpoints::new(self.site.store, &key, &self.node, self.site.listener);
        let metadata = self.metadata();
        let produced = self.produce(&checkpoints, &metadata);
        match produced.map_err(|error| self.blame(error))? {
            Produced::Children(specs) => Ok(Done::Expanded(specs)),
            Produced::Outputs(outputs, counts) => {
                let record = self.keep(outputs, metadata)?;
                checkpoints.remove();
                Ok(Done::Finished(record, counts))
            }
        }
    }

    /// A stage that cannot write is not to blame where the store cannot write either (a full disk, a lock).
    fn blame(&self, error: StageError) -> Fault {
        match &error {
            StageError::Blob(blob) if blob.lost.is_none() => match self.site.store.commit() {
                Err(trouble) => Fault::Store(trouble),
                Ok(()) => Fault::Stage(error),
            },
            _ => Fault::Stage(error),
        }
    }

    fn produce(&self, checkpoints: &dyn Checkpoints, metadata: &RunMetadata) -> Result<Produced, StageError> {
        let blobs = StoreBlobs(self.site.store);
        let memos = StoreMemos::new(self.site.store, &self.node, self.site.listener);
        let progress = NodeProgress::new(&self.node, self.site.listener);
        let stage: &dyn Stage = self.bound.as_ref();
        let scratch = self.site.store.scratch();
        let ctx = Ctx {
            blobs: &blobs,
            cancel: self.site.cancel,
            progress: &progress,
            checkpoints,
            memos: &memos,
            scratch: &scratch,
            threads: self.threads,
        };
        let job = Job {
            store: self.site.store,
            ctx,
            def: &self.def,
            stage,
            inputs: &self.order.inputs,
            listing: self.order.listing.as_ref(),
            check: self.check,
            metadata,
        };
        let act = || match &self.step {
            Step::Start => perform(&job),
            Step::Reduce(children, _) => {
                reduce(&job, children).map(|(outputs, counts)| Produced::Outputs(outputs, counts))
            }
        };
        on_threads(self.threads, act)
    }

    /// Checks and stores what came out, and returns what the store keeps for the key.
    fn keep(&self, outputs: Outputs, metadata: RunMetadata) -> Result<Box<Record>, Fault> {
        self.check_names(&outputs)?;
        let store = self.site.store;
        let outputs: BTreeMap<String, Output> = sized(store, outputs)?;
        let children = match &self.step {
            Step::Start => BTreeMap::new(),
            Step::Reduce(_, keys) => keys.clone(),
        };
        let record = Record {
            key: self.order.key.digest,
            stage: self.def.name.to_owned(),
            version: self.def.version,
            manifest: self.order.key.manifest.clone(),
            outputs,
            children,
            metadata: RunMetadata {
                seconds: self.began.elapsed().as_secs_f64(),
                peak_mb: peak_mb(),
                ..metadata
            },
        };
        store.put_record(record.clone());
        store.commit()?;
        self.tell_conflicts();
        let kept = store.hit(&record.key)?.unwrap_or(record);
        Ok(Box::new(kept))
    }

    fn check_names(&self, outputs: &Outputs) -> Result<(), StageError> {
        let declared = self.def.outputs;
        // A name that ends with `/` is a family of any number.
        let is_family = |name: &str| name.ends_with('/');
        let covers = |declared: &&str, name: &str| {
            *declared == name || (is_family(declared) && name.starts_with(*declared))
        };
        let mut wanted = declared.iter().filter(|name| !is_family(name));
        if let Some(absent) = wanted.find(|&&name| !outputs.contains_key(name)) {
            return Err(bug(format!("its output `{absent}` did not come")));
        }
        let known = |name: &str| declared.iter().any(|declared| covers(declared, name));
        match outputs.keys().find(|name| !known(name)) {
            Some(foreign) => Err(bug(format!("its output `{foreign}` is not declared"))),
            None => Ok(()),
        }
    }

    /// Conflicts of other nodes may come along: a group is committed by whoever ends first.
    fn tell_conflicts(&self) {
        for conflict in self.site.store.conflicts() {
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

    fn device(&self) -> String {
        self.bound.backend_id().unwrap_or_else(|| "cpu".to_owned())
    }

    fn metadata(&self) -> RunMetadata {
        RunMetadata {
            seconds: 0.0,
            peak_mb: 0,
            started_unix_s: unix_seconds(),
            device: self.device(),
            program: self.site.program.to_owned(),
        }
    }
}

/// Runs in a pool of that many threads; a panic becomes a failure.
fn on_threads(
    threads: usize,
    act: impl Fn() -> Result<Produced, StageError> + Send,
) -> Result<Produced, StageError> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .stack_size(STACK_BYTES)
        .build()
        .map_err(|error| StageError::new(format!("{threads} threads cannot be started: {error}")))?;
    pool.install(|| catch_unwind(AssertUnwindSafe(act)))
        .unwrap_or_else(|payload| Err(panicked(payload.as_ref())))
}

pub(super) fn unix_seconds() -> u64 {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    since.map_or(0, |since| since.as_secs())
}

/// Largest memory of this program so far, in MB; 0 where the system does not tell.
fn peak_mb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kb = line.and_then(|line| line.trim().trim_end_matches("kB").trim().parse::<u64>().ok());
    kb.unwrap_or(0) / 1024
}
