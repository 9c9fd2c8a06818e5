//! The scheduler: a coordinator thread starts ready nodes while thread permits are free.
//!
//! A job of one thread takes one permit; a job that can use all takes its share of the free ones, hence all when
//! nothing else is ready. One node at a time is on a GPU. The order of jobs and their threads change no result.

use std::{
    sync::{Arc, mpsc},
    thread,
    time::Instant,
};

use marf_cache::StoreError;
use marf_stage::{Outputs, Threads};

use super::{
    job::{Job, JobError, JobOutput, Step},
    prepare::prepare_all,
    recover,
    state::RunState,
    task::{Phase, Reuse, Task},
};
use crate::{errors::contract_violation, needs::Needs, work::BlobCheck};

/// Starts jobs on threads of their own, and applies what they report to the state of the run.
pub(super) struct Scheduler<'a> {
    state: RunState<'a>,
    free_permits: usize,
    running: usize,
}

/// The end of a job.
struct JobReport {
    index: usize,
    permits: usize,
    result: Result<JobOutput, JobError>,
}

impl<'a> Scheduler<'a> {
    /// Returns a scheduler with as many permits as the run may use threads.
    pub(super) fn new(state: RunState<'a>, threads: usize) -> Self {
        Self {
            state,
            free_permits: threads,
            running: 0,
        }
    }

    /// Runs until no node can make progress, and returns the final state. After an error of the store it only
    /// waits for running jobs.
    pub(super) fn run(mut self) -> Result<RunState<'a>, StoreError> {
        let (sender, receiver) = mpsc::channel();
        let mut outcome = Ok(());
        thread::scope(|scope| {
            loop {
                if outcome.is_ok() {
                    outcome = prepare_all(&mut self.state);
                }
                while outcome.is_ok()
                    && let Some((index, permits)) = self.next()
                {
                    let job = self.start(index, permits);
                    let sender = sender.clone();
                    scope.spawn(move || {
                        let result = job.map_or_else(|| Err(not_prepared()), Job::execute);
                        // The receiver lives until all jobs have reported.
                        let _ = sender.send(JobReport {
                            index,
                            permits,
                            result,
                        });
                    });
                }
                if self.running == 0 {
                    return;
                }
                let Ok(report) = receiver.recv() else { return };
                let applied = self.apply(report);
                if outcome.is_ok() {
                    outcome = applied;
                }
            }
        });
        outcome?;
        self.state.mark_stopped();
        Ok(self.state)
    }

    /// Returns the first node that may start, and its number of permits.
    fn next(&self) -> Option<(usize, usize)> {
        if self.free_permits == 0 || self.state.context.cancel.is_set() {
            return None;
        }
        // Two trainings on one GPU would only alternate, with the memory of both.
        let is_on_gpu = |task: &Task| task.bound.backend_id().is_some();
        let tasks = &self.state.tasks;
        let gpu_is_busy = tasks
            .iter()
            .filter(|task| task.phase == Phase::Running)
            .any(is_on_gpu);
        let is_ready = |task: &&Task| {
            matches!(task.phase, Phase::Ready | Phase::Reducible) && !(gpu_is_busy && is_on_gpu(task))
        };
        let ready = tasks.iter().filter(is_ready).count();
        let index = tasks.iter().position(|task| is_ready(&task))?;
        let permits = match Needs::of(tasks[index].bound.as_ref(), None).cores {
            Threads::One => 1,
            Threads::All => (self.free_permits / ready).max(1),
        };
        Some((index, permits))
    }

    /// Takes the permits of a node and returns its job; none if the node was not prepared.
    fn start(&mut self, index: usize, permits: usize) -> Option<Job<'a>> {
        self.free_permits -= permits;
        self.running += 1;
        let step = match self.state.tasks[index].phase {
            Phase::Reducible => self.after_round(index),
            _ => Step::Start,
        };
        if matches!(step, Step::Start) {
            self.state.begin(index);
        }
        let task = &mut self.state.tasks[index];
        task.phase = Phase::Running;
        Some(Job {
            context: self.state.context,
            node: task.name.clone(),
            def: task.def,
            bound: Arc::clone(&task.bound),
            prepared: task.prepared.clone()?,
            step,
            check: match task.reuse {
                Reuse::Allowed => BlobCheck::Outputs,
                Reuse::Forbidden => BlobCheck::Needs,
            },
            threads: permits,
            began: *task.began.get_or_insert_with(Instant::now),
        })
    }

    /// Returns the step of an expansion after a round of children: with outputs and keys of all so far.
    fn after_round(&self, index: usize) -> Step {
        let tasks = &self.state.tasks;
        let children = || tasks[index].children.iter().map(|&child| &tasks[child]);
        let outputs: Vec<Outputs> = children().map(Task::outputs).collect();
        let prefix = tasks[index].name.len() + 1;
        let keys = children().filter_map(|child| Some((child.name[prefix..].to_owned(), child.outcome.key?)));
        Step::AfterRound(outputs, keys.collect())
    }

    /// Frees the permits of a job and applies its result.
    fn apply(&mut self, report: JobReport) -> Result<(), StoreError> {
        self.free_permits += report.permits;
        self.running -= 1;
        let (state, index) = (&mut self.state, report.index);
        match report.result {
            Ok(JobOutput::Reused(record)) => state.reuse(index, *record),
            Ok(JobOutput::Finished(record)) => state.finish(index, *record),
            Ok(JobOutput::Expanded(specs)) => state.expand(index, specs),
            Err(JobError::Store(error)) => {
                state.tasks[index].phase = Phase::Stopped;
                return Err(error);
            }
            Err(JobError::Stage(error)) => match recover::lost_blob(state, index, &error) {
                Some(lost) => recover::recover(state, index, &lost),
                None => state.fail(index, error),
            },
        }
        Ok(())
    }
}

fn not_prepared() -> JobError {
    JobError::Stage(contract_violation(
        "it was started before it was ready".to_owned(),
    ))
}
