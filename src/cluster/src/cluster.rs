//! The executor: each action that it takes is a job, from its submission to its result.

use std::{
    collections::BTreeSet,
    fmt, fs, io,
    path::PathBuf,
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use marf_cache::{Action, Digest, StoreError};
use marf_engine::{Executor, Needs, Order, PartOrder};
use marf_remote::{Observer, Progress, Remote, RemoteError};
use marf_stage::{Cancel, StageError, Threads};
use parking_lot::Mutex;

use crate::{
    arrays::Arrays,
    commands::Listed,
    job_files::JobFiles,
    job_result::{Fault, JobProgress, JobResult},
    queue::{Census, PREFIX, Queue, Sight},
    script::{Filling, TASK, filled, quoted_path},
    site::{Site, SiteError},
    words::{in_short, note},
};

/// How often a job may be lost.
pub(crate) const ATTEMPTS: u32 = 3;

/// Longest time until a wish to stop is heard.
const LOOK_INTERVAL: Duration = Duration::from_millis(200);

/// Results that are fetched at once: what comes is in memory until all of them are there.
const KEYS_AT_ONCE: usize = 256;

/// Longest fetch of results that are known.
const FETCH_PATIENCE: Duration = Duration::from_secs(600);

/// Digits of the key in the name of a job.
const NAME_DIGITS: usize = 16;

/// Words of a batch system that is busy for a moment.
const BUSY: [&str; 3] = ["timed out", "nable to contact", "temporarily"];

/// A batch system that computes the nodes of a run.
pub struct Cluster {
    pub(crate) site: Site,
    pub(crate) script: String,
    pub(crate) marf: PathBuf,
    pub(crate) remote: Arc<Remote>,
    pub(crate) queue: Queue,
    /// When this run began to look at the queue.
    pub(crate) began: Instant,
    /// Keys whose results are in the shared store. One push at a time.
    shared: Mutex<BTreeSet<Digest>>,
}

impl fmt::Debug for Cluster {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Cluster")
            .field("site", &self.site)
            .finish_non_exhaustive()
    }
}

/// A job in the queue.
pub(crate) struct Job {
    pub(crate) id: String,
    /// Answers of the batch system from before tell nothing of it.
    pub(crate) since: Instant,
}

/// How the wait for a job ended.
enum Ended {
    Told(JobResult),
    /// It is in neither the queue nor the folder; with what the batch system says of it.
    Lost(String),
}

impl Executor for Cluster {
    fn takes(&self, action: &Action) -> bool {
        self.site.stages.contains(&action.stage)
    }

    fn slots(&self) -> usize {
        self.site.max_jobs
    }

    fn execute(&self, order: &Order<'_>) -> Result<(), StageError> {
        let files = JobFiles::of(&self.site.folder, &order.key);
        if !self.fetch(order)? {
            self.share(order)?;
            self.run(order, &files)?;
            if !self.fetch(order)? {
                let message = format!(
                    "`{}`: its job is done, and the shared store lacks its result",
                    order.node
                );
                return Err(StageError::new(message)
                    .hint("is `store` of the site file the same place on all machines?"));
            }
        }
        files.remove();
        Ok(())
    }

    fn takes_parts(&self, action: &Action, photos: u64) -> bool {
        // Another script may be of a batch system without arrays.
        self.takes(action) && photos >= self.site.photos_per_task && self.script.contains(TASK)
    }

    fn execute_parts(&self, order: &Order<'_>, parts: &[PartOrder]) -> Result<(), StageError> {
        Arrays::new(self, order).run(parts)
    }
}

impl Cluster {
    /// Returns the batch system of a site, whose shared store is open.
    ///
    /// # Errors
    /// A template that cannot be read; a folder that cannot be made; a batch system that does not answer.
    pub fn new(site: Site, remote: Arc<Remote>, program: PathBuf) -> Result<Self, SiteError> {
        site.commands.list().map_err(|said| SiteError::Silent { said })?;
        fs::create_dir_all(&site.folder).map_err(|source| SiteError::Read {
            path: site.folder.clone(),
            source,
        })?;
        Ok(Self {
            script: site.script()?,
            marf: site.marf.clone().unwrap_or(program),
            remote,
            queue: Queue::new(Duration::from_secs_f64(site.poll_s)),
            began: Instant::now(),
            shared: Mutex::default(),
            site,
        })
    }

    /// Brings all that an action reads into the shared store.
    pub(crate) fn share(&self, order: &Order<'_>) -> Result<(), StageError> {
        let mut shared = self.shared.lock();
        let new: Vec<Digest> = order
            .results
            .iter()
            .filter(|key| !shared.contains(key))
            .copied()
            .collect();
        let blobs = foreign_inputs(order).map_err(|error| failed(order, "inputs cannot be read", &error))?;
        if new.is_empty() && blobs.is_empty() {
            return Ok(());
        }
        order.progress.at(0, 0, "inputs go to the shared store");
        let pushed = self
            .remote
            .send(order.store, &new, &blobs, &Watcher(order.cancel));
        pushed.map_err(|error| remote_failed(order, "inputs cannot be shared", error))?;
        shared.extend(new);
        Ok(())
    }

    /// Has a job made until there is a result; a lost job is submitted again.
    fn run(&self, order: &Order<'_>, files: &JobFiles) -> Result<(), StageError> {
        let mut memory_mb = self.memory_mb(&order.needs);
        let mut attempts_left = ATTEMPTS;
        loop {
            let script = || self.write(order, files, memory_mb);
            let job = self.job(order, &job_name(&order.key), &script)?;
            let said = match self.wait(order, files, &job)? {
                Ended::Told(result) => return told(order, result),
                Ended::Lost(said) => said,
            };
            let was_too_large = said.contains("OUT_OF_MEMORY");
            if was_too_large {
                memory_mb = memory_mb.saturating_mul(2);
            }
            attempts_left -= 1;
            if attempts_left == 0 {
                return Err(self.lost(order, files, &job, &said));
            }
            let again = match was_too_large {
                true => format!("with {memory_mb} MB"),
                false => "again".to_owned(),
            };
            order.progress.warn(&format!(
                "job {} ended without a result ({}); it is submitted {again}",
                job.id,
                in_short(&said),
            ));
        }
    }

    /// Returns the job of this name that is in the queue, or else submits one with the script that `write` writes.
    pub(crate) fn job(
        &self,
        order: &Order<'_>,
        name: &str,
        write: &dyn Fn() -> io::Result<PathBuf>,
    ) -> Result<Job, StageError> {
        let asked = Instant::now();
        let mut busy = String::new();
        while asked.elapsed() < self.patience() {
            if order.cancel.is_set() {
                return Err(StageError::Cancelled);
            }
            match self.queue.look(&self.site.commands, name, self.began) {
                Sight::There(listed, _) if !listed.is_empty() => {
                    let since = self.began;
                    let id = listed[0].id.clone();
                    return Ok(Job { id, since });
                }
                Sight::Unknown(fault) => busy = fault,
                Sight::Absent | Sight::There(..) => match self.submit(order, write)? {
                    Ok(job) => return Ok(job),
                    Err(said) => busy = said,
                },
            }
            self.rest(order.cancel);
        }
        let seconds = self.patience().as_secs_f64();
        let error =
            StageError::new(format!("the batch system does not answer for {seconds:.0} s")).cause(busy);
        Err(error.hint("try its commands by hand, and run again: what was computed is kept"))
    }

    /// Submits a job; of a batch system that is busy it returns what that says.
    fn submit(
        &self,
        order: &Order<'_>,
        write: &dyn Fn() -> io::Result<PathBuf>,
    ) -> Result<Result<Job, String>, StageError> {
        let unwritten = |error: io::Error| failed(order, "the files of its job cannot be written", &error);
        let script = write().map_err(unwritten)?;
        let since = Instant::now();
        match self.site.commands.submit(&script.display().to_string()) {
            Ok(id) => Ok(Ok(Job { id, since })),
            Err(said) if BUSY.iter().any(|word| said.contains(word)) => Ok(Err(said)),
            Err(said) => {
                let error = StageError::new(format!("the batch system takes no job for `{}`", order.node))
                    .cause(said);
                Err(error.hint(format!("the script is {}", script.display())))
            }
        }
    }

    /// Writes the action and the script of a job, and removes a result that is none; returns where the script is.
    fn write(&self, order: &Order<'_>, files: &JobFiles, memory_mb: u64) -> io::Result<PathBuf> {
        match fs::remove_file(&files.result) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => fs::write(&files.action, order.action.encode())?,
        }
        let gpu = self.site.gpu_options.iter().filter(|_| order.needs.gpu);
        let options: Vec<String> = self.site.options.iter().chain(gpu).cloned().collect();
        let filling = Filling {
            name: &job_name(&order.key),
            task: "",
            action: quoted_path(&files.action),
            store: &self.site.store,
            marf: &self.marf,
            log: &files.log,
            result: quoted_path(&files.result),
            scratch: quoted_path(&files.scratch),
            cores: match order.needs.cores {
                Threads::One => 1,
                Threads::All => self.site.cores,
            },
            memory_mb,
            minutes: self.site.minutes,
            options: &options,
        };
        fs::write(&files.script, filled(&self.script, &filling))?;
        Ok(files.script.clone())
    }

    /// Waits until a job has told how it ended, or is lost.
    fn wait(&self, order: &Order<'_>, files: &JobFiles, job: &Job) -> Result<Ended, StageError> {
        let name = job_name(&order.key);
        let mut absent_since: Option<Instant> = None;
        loop {
            if let Some(result) = JobResult::read(&files.result, &order.key) {
                return Ok(Ended::Told(result));
            }
            if order.cancel.is_set() {
                if let Err(said) = self.site.commands.cancel(&job.id) {
                    order
                        .progress
                        .warn(&format!("job {} cannot be stopped: {said}", job.id));
                }
                return Err(StageError::Cancelled);
            }
            match self.queue.look(&self.site.commands, &name, job.since) {
                Sight::There(listed, census) => {
                    absent_since = None;
                    if let [listed, ..] = listed.as_slice() {
                        show(order, files, listed, census);
                    }
                }
                Sight::Unknown(fault) => {
                    absent_since = None;
                    let state = if fault.is_empty() {
                        "submitted"
                    } else {
                        "the queue cannot be seen"
                    };
                    order.progress.at(0, 0, &note(&job.id, state, &fault));
                }
                Sight::Absent => {
                    let since = *absent_since.get_or_insert_with(Instant::now);
                    if since.elapsed() >= self.patience() {
                        return Ok(Ended::Lost(self.site.commands.explain(&job.id)));
                    }
                }
            }
            self.rest(order.cancel);
        }
    }

    /// Brings those results of keys that are in the shared store.
    pub(crate) fn fetch_known(&self, order: &Order<'_>, keys: &[Digest]) -> Result<(), RemoteError> {
        let observer = Watcher(order.cancel);
        for some in keys.chunks(KEYS_AT_ONCE) {
            // What is damaged or not whole there is made again.
            self.remote.fetch(order.store, some, FETCH_PATIENCE, &observer)?;
        }
        Ok(())
    }

    /// Brings the result of an action from the shared store; tells whether it is there.
    fn fetch(&self, order: &Order<'_>) -> Result<bool, StageError> {
        let fetched = self
            .remote
            .bring(order.store, &[order.key], &Watcher(order.cancel));
        match fetched {
            Ok(_) => {
                self.shared.lock().insert(order.key);
                Ok(true)
            }
            Err(RemoteError::Absent { .. } | RemoteError::Missing { .. }) => Ok(false),
            Err(error) => Err(remote_failed(order, "its result cannot be fetched", error)),
        }
    }

    fn lost(&self, order: &Order<'_>, files: &JobFiles, job: &Job, said: &str) -> StageError {
        let error = StageError::new(format!(
            "`{}`: {ATTEMPTS} jobs ended without a result, the last was {} ({})",
            order.node,
            job.id,
            in_short(said)
        ));
        let error = match files.log_tail() {
            Some(tail) => error.cause(tail),
            None => error,
        };
        error.hint(format!(
            "see {}; `memory_mb` and `minutes` of the site file are what a job may take",
            files.log.display()
        ))
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

fn job_name(key: &Digest) -> String {
    format!("{PREFIX}{}", &key.to_string()[..NAME_DIGITS])
}

/// Returns the blobs that an action reads and that no result of the run consists of: those that its parent has made for it.
fn foreign_inputs(order: &Order<'_>) -> Result<Vec<Digest>, StoreError> {
    let mut known: BTreeSet<Digest> = BTreeSet::new();
    for key in order.results {
        let record = order.store.record(key)?;
        known.extend(
            record
                .iter()
                .flat_map(|record| record.outputs.values())
                .map(|output| output.digest),
        );
    }
    let inputs = order.action.inputs.values();
    let foreign: Vec<Digest> = inputs.filter(|digest| !known.contains(digest)).copied().collect();
    match foreign.is_empty() {
        true => Ok(foreign),
        false => order.store.closure(&[], &foreign).map(|closure| closure.blobs),
    }
}

/// Shows what the batch system and the job itself say of it.
fn show(order: &Order<'_>, files: &JobFiles, listed: &Listed, census: Census) {
    let Census { running, waiting } = census;
    let mut note = note(&listed.id, &listed.state, &listed.reason);
    if running + waiting > 1 {
        note.push_str(&format!("; of {} jobs {running} run", running + waiting));
    }
    match JobProgress::read(&files.progress) {
        Some(job) => order
            .progress
            .at(job.done, job.total, &format!("{note}; {}", job.note)),
        None => order.progress.at(0, 0, &note),
    }
}

/// Tells the warnings of a job, and why it has no result if it has none.
pub(crate) fn told(order: &Order<'_>, result: JobResult) -> Result<(), StageError> {
    result
        .warnings
        .iter()
        .for_each(|warning| order.progress.warn(warning));
    let Some(Fault { message, cause, hint }) = result.fault else {
        return Ok(());
    };
    Err(StageError::Failed { message, cause, hint })
}

pub(crate) fn failed(order: &Order<'_>, what: &str, error: &dyn fmt::Display) -> StageError {
    StageError::new(format!("`{}`: {what}", order.node)).cause(error.to_string())
}

pub(crate) fn remote_failed(order: &Order<'_>, what: &str, error: RemoteError) -> StageError {
    match error {
        RemoteError::Stopped => StageError::Cancelled,
        error => failed(order, what, &error),
    }
}

/// Stops the work on a shared store when the user wants to stop.
pub(crate) struct Watcher<'a>(pub(crate) &'a Cancel);

impl Observer for Watcher<'_> {
    fn on_progress(&self, _progress: Progress) {}

    fn is_stopped(&self) -> bool {
        self.0.is_set()
    }
}
