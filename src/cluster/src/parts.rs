//! Parts of a node as jobs, each of some parts.

use std::{
    sync::atomic::{AtomicU64, AtomicUsize, Ordering},
    thread,
    time::Duration,
};

use marf_cache::Digest;
use marf_engine::{Order, PartOrder};
use marf_stage::{Cancel, Progress, StageError};

use crate::{
    cluster::{Cluster, KEYS_AT_ONCE},
    errors::remote_failed,
    job::JobOrder,
    job_files::JobFiles,
};

/// Time between two looks whether all jobs are done.
const LOOK_INTERVAL: Duration = Duration::from_millis(50);

impl Cluster {
    /// Has parts of a node computed, and fetches their results.
    ///
    /// # Errors
    /// That of the first job without a result. The other jobs are then cancelled.
    pub(crate) fn run_parts(&self, order: &Order<'_>, parts: &[PartOrder]) -> Result<(), StageError> {
        let lacks = |part: &PartOrder| order.store.hit(&part.key).is_ok_and(|record| record.is_none());
        let absent: Vec<Digest> = parts
            .iter()
            .filter(|part| lacks(part))
            .map(|part| part.key)
            .collect();
        let fetched = self.fetch_known(order, &absent);
        fetched.map_err(|error| remote_failed(order.node, "results cannot be fetched", error))?;
        let mut jobs = self.grouped(parts);
        jobs.retain(|job| job.iter().any(lacks));
        if jobs.is_empty() {
            return Ok(());
        }
        self.share(order)?;
        let run = PartsRun {
            cluster: self,
            order,
            total: jobs.iter().map(|job| job.len() as u64).sum(),
            jobs,
            next: AtomicUsize::new(0),
            done: AtomicU64::new(0),
            stop: Cancel::default(),
        };
        run.run()
    }

    /// Splits parts into jobs of at least `photos_per_task` photos. A later run of the same node makes the same jobs, and so finds
    /// them in the queue.
    fn grouped<'p>(&self, parts: &'p [PartOrder]) -> Vec<&'p [PartOrder]> {
        let (mut jobs, mut first, mut photos) = (Vec::new(), 0, 0);
        for (at, part) in parts.iter().enumerate() {
            photos += part.photos;
            if photos >= self.site.photos_per_task || at + 1 == parts.len() {
                jobs.push(&parts[first..=at]);
                (first, photos) = (at + 1, 0);
            }
        }
        jobs
    }
}

/// The jobs of the parts of one node.
struct PartsRun<'a> {
    cluster: &'a Cluster,
    order: &'a Order<'a>,
    /// The parts of each job.
    jobs: Vec<&'a [PartOrder]>,
    /// Number of the next job to submit.
    next: AtomicUsize,
    /// Number of parts with a result.
    done: AtomicU64,
    /// Number of parts.
    total: u64,
    /// Set if the user wants to stop, or if a job has failed.
    stop: Cancel,
}

impl PartsRun<'_> {
    /// Follows as many jobs at once as the site allows.
    fn run(&self) -> Result<(), StageError> {
        let followers = self.jobs.len().min(self.cluster.site.max_jobs);
        thread::scope(|scope| {
            let followers: Vec<_> = (0..followers).map(|_| scope.spawn(|| self.follow())).collect();
            while !followers.iter().all(thread::ScopedJoinHandle::is_finished) {
                if self.order.cancel.is_set() {
                    self.stop.set();
                }
                thread::sleep(LOOK_INTERVAL);
            }
            let mut ended = Ok(());
            for follower in followers {
                match follower.join() {
                    Err(panic) => std::panic::resume_unwind(panic),
                    // A job that another one's failure has stopped says nothing about why.
                    Ok(Err(error)) if ended.is_ok() || !matches!(error, StageError::Cancelled) => {
                        ended = Err(error);
                    }
                    Ok(_) => {}
                }
            }
            ended
        })
    }

    /// Runs one job after the other, until none is left or one has failed.
    fn follow(&self) -> Result<(), StageError> {
        while let Some(parts) = self.jobs.get(self.next.fetch_add(1, Ordering::Relaxed)) {
            if self.stop.is_set() {
                return Err(StageError::Cancelled);
            }
            let ended = self.job(parts);
            if ended.is_err() {
                self.stop.set();
            }
            ended?;
        }
        Ok(())
    }

    fn job(&self, parts: &[PartOrder]) -> Result<(), StageError> {
        let actions: Vec<&[u8]> = parts.iter().map(|part| part.action.as_slice()).collect();
        let actions = actions.join(&b'\n');
        let key = Digest::from_content(&actions);
        let job = JobOrder {
            node: self.order.node,
            key,
            actions,
            needs: self.order.needs,
            progress: self,
            cancel: &self.stop,
        };
        self.cluster.run(&job)?;
        let keys: Vec<Digest> = parts.iter().map(|part| part.key).collect();
        for some in keys.chunks(KEYS_AT_ONCE) {
            self.cluster.bring_told(self.order, some)?;
        }
        JobFiles::new(&self.cluster.site.folder, &key).remove();
        self.done.fetch_add(parts.len() as u64, Ordering::Relaxed);
        Ok(())
    }
}

/// Counts parts, not what one job says of itself.
impl Progress for PartsRun<'_> {
    fn at(&self, _done: u64, _total: u64, note: &str) {
        let done = self.done.load(Ordering::Relaxed);
        self.order.progress.at(done, self.total, note);
    }

    fn warn(&self, message: &str) {
        self.order.progress.warn(message);
    }
}
