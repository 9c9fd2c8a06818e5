//! One job: submitted, followed, submitted again if it is lost, until its file reports its end.

use std::{fs, io, time::Instant};

use marf_cache::Digest;
use marf_engine::{Needs, Order};
use marf_stage::{Cancel, Progress, StageError, Threads};

use crate::{
    cluster::Cluster,
    commands::ListedJob,
    errors::failed,
    job_files::JobFiles,
    job_result::{Fault, JobProgress, JobResult},
    queue::{Census, JobState, PREFIX},
    script::{Filling, filled},
    words::{in_short, memory, note},
};

/// How often a job may be lost.
const ATTEMPTS: u32 = 3;

/// Digits of the key in the name of a job.
const NAME_DIGITS: usize = 16;

/// Words of a batch system that is busy for a moment.
const BUSY: [&str; 3] = ["timed out", "nable to contact", "temporarily"];

/// A job in the queue.
struct Job {
    id: String,
    /// Earlier answers of the batch system say nothing about it.
    since: Instant,
}

/// The work of a job, and its follower.
pub(crate) struct JobOrder<'a> {
    /// What people call it: the name of a node.
    pub(crate) node: &'a str,
    /// The digest of its action.
    pub(crate) key: Digest,
    /// The bytes of its action, or of a question.
    pub(crate) action: Vec<u8>,
    pub(crate) needs: Needs,
    pub(crate) progress: &'a dyn Progress,
    pub(crate) cancel: &'a Cancel,
}

impl<'a> JobOrder<'a> {
    pub(crate) fn new(order: &Order<'a>) -> Self {
        Self {
            node: order.node,
            key: order.key,
            action: order.action.encode(),
            needs: order.needs,
            progress: order.progress,
            cancel: order.cancel,
        }
    }
}

/// How the wait for a job ended.
enum JobEnd {
    Result(JobResult),
    /// It is in neither the queue nor the folder. Holds the explanation of the batch system.
    Lost(String),
}

impl Cluster {
    /// Runs a job until there is a result. A lost job is submitted again.
    ///
    /// # Errors
    /// Returns an error if the batch system refuses the job, if the job reports a fault, or if too many jobs were
    /// lost.
    pub(crate) fn run(&self, order: &JobOrder<'_>) -> Result<JobResult, StageError> {
        let files = &JobFiles::new(&self.site.folder, &order.key);
        let mut memory_mb = self.memory_mb(&order.needs);
        let mut attempts_left = ATTEMPTS;
        loop {
            let job = self.job(order, files, memory_mb)?;
            let said = match self.wait(order, files, &job)? {
                JobEnd::Result(result) => return self.outcome(order.progress, result),
                JobEnd::Lost(said) => said,
            };
            let was_too_large = said.contains("OUT_OF_MEMORY");
            if was_too_large {
                memory_mb = memory_mb.saturating_mul(2);
            }
            attempts_left -= 1;
            if attempts_left == 0 {
                return Err(lost(order, files, &job, &said));
            }
            let again = if was_too_large {
                format!("with {}", memory(memory_mb))
            } else {
                "again".to_owned()
            };
            order.progress.warn(&format!(
                "job {} ended without a result ({}) and is submitted {again}",
                job.id,
                in_short(&said),
            ));
        }
    }

    /// Returns the job of an order that is in the queue, or else submits one.
    fn job(&self, order: &JobOrder<'_>, files: &JobFiles, memory_mb: u64) -> Result<Job, StageError> {
        let name = job_name(&order.key);
        let asked = Instant::now();
        let mut busy = String::new();
        while asked.elapsed() < self.patience() {
            if order.cancel.is_set() {
                return Err(StageError::Cancelled);
            }
            match self
                .queue
                .look(&self.site.commands, &name, self.began, order.cancel)
            {
                JobState::Listed(listed, _) => {
                    let since = self.began;
                    let id = listed.id;
                    return Ok(Job { id, since });
                }
                JobState::Unknown(fault) => busy = fault,
                JobState::Absent => match self.submit(order, files, memory_mb)? {
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

    /// Submits a job. If the batch system is busy, returns its message.
    fn submit(
        &self,
        order: &JobOrder<'_>,
        files: &JobFiles,
        memory_mb: u64,
    ) -> Result<Result<Job, String>, StageError> {
        let node = order.node;
        let unwritten = |error: io::Error| failed(node, "the files of its job cannot be written", &error);
        self.write(order, files, memory_mb).map_err(unwritten)?;
        let script = files.script.display().to_string();
        let since = Instant::now();
        match self.site.commands.submit(&script, order.cancel) {
            Ok(id) => Ok(Ok(Job { id, since })),
            Err(said) if BUSY.iter().any(|word| said.contains(word)) => Ok(Err(said)),
            Err(said) => {
                let error =
                    StageError::new(format!("the batch system takes no job for `{node}`")).cause(said);
                Err(error.hint(format!("the script is {script}")))
            }
        }
    }

    /// Writes the action and the script of a job, and removes an invalid result.
    fn write(&self, order: &JobOrder<'_>, files: &JobFiles, memory_mb: u64) -> io::Result<()> {
        match fs::remove_file(&files.result) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => fs::write(&files.action, &order.action)?,
        }
        let gpu = self.site.gpu_options.iter().filter(|_| order.needs.gpu);
        let options: Vec<String> = self.site.options.iter().chain(gpu).cloned().collect();
        let filling = Filling {
            name: &job_name(&order.key),
            action: &files.action,
            store: &self.site.store,
            marf: &self.marf,
            log: &files.log,
            result: &files.result,
            scratch: &files.scratch,
            cores: match order.needs.cores {
                Threads::One => 1,
                Threads::All => self.site.cores,
            },
            memory_mb,
            minutes: self.site.minutes,
            options: &options,
        };
        fs::write(&files.script, filled(&self.script, &filling))
    }

    /// Waits until a job has reported its end, or is lost.
    fn wait(&self, order: &JobOrder<'_>, files: &JobFiles, job: &Job) -> Result<JobEnd, StageError> {
        let name = job_name(&order.key);
        let mut absent_since: Option<Instant> = None;
        loop {
            if let Some(result) = JobResult::read(&files.result, &order.key) {
                return Ok(JobEnd::Result(result));
            }
            if order.cancel.is_set() {
                if let Err(said) = self.site.commands.cancel(&job.id) {
                    order
                        .progress
                        .warn(&format!("job {} cannot be stopped: {said}", job.id));
                }
                return Err(StageError::Cancelled);
            }
            match self
                .queue
                .look(&self.site.commands, &name, job.since, order.cancel)
            {
                JobState::Listed(listed, census) => {
                    absent_since = None;
                    show(order, files, &listed, census);
                }
                JobState::Unknown(fault) => {
                    absent_since = None;
                    let state = if fault.is_empty() {
                        "submitted"
                    } else {
                        "the queue cannot be seen"
                    };
                    order.progress.at(0, 0, &note(&job.id, state, &fault));
                }
                JobState::Absent => {
                    let since = *absent_since.get_or_insert_with(Instant::now);
                    if since.elapsed() >= self.patience() {
                        let said = self.site.commands.explain(&job.id, order.cancel);
                        return Ok(JobEnd::Lost(said));
                    }
                }
            }
            self.rest(order.cancel);
        }
    }

    /// Shows the warnings of a job. Returns its result, or its fault as an error.
    fn outcome(&self, progress: &dyn Progress, result: JobResult) -> Result<JobResult, StageError> {
        result.warnings.iter().for_each(|warning| progress.warn(warning));
        match result.fault {
            None => Ok(result),
            Some(Fault {
                message,
                cause,
                hint,
                is_elsewhere,
            }) => {
                if is_elsewhere {
                    self.forget_backend();
                }
                Err(StageError::Failed { message, cause, hint })
            }
        }
    }
}

fn lost(order: &JobOrder<'_>, files: &JobFiles, job: &Job, said: &str) -> StageError {
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
        "see {}. `memory_mb` and `minutes` of the site file limit a job",
        files.log.display()
    ))
}

fn job_name(key: &Digest) -> String {
    format!("{PREFIX}{}", &key.to_string()[..NAME_DIGITS])
}

/// Shows what the batch system and the job itself say of it.
fn show(order: &JobOrder<'_>, files: &JobFiles, listed: &ListedJob, census: Census) {
    let Census { running, waiting } = census;
    let mut note = note(&listed.id, &listed.state, &listed.reason);
    let all = running.saturating_add(waiting);
    if all > 1 {
        note.push_str(&format!(", {running} of {all} jobs running"));
    }
    match JobProgress::read(&files.progress) {
        Some(job) => order
            .progress
            .at(job.done, job.total, &format!("{note}; {}", job.note)),
        None => order.progress.at(0, 0, &note),
    }
}
