//! The scheduler: a coordinator thread starts ready nodes while thread permits are free.
//!
//! An action that an executor takes runs on another machine and needs no permit. Ready nodes start in the order of the pipeline, and
//! children of expanding nodes after all of these. A job of one thread takes one permit. A job that can use all shares the free ones with
//! the others of its kind that are ready: nodes of the pipeline, or children. One node at a time is on the GPU of this machine. The order of
//! jobs and their threads do not change any result.

use std::{
    collections::BTreeSet,
    sync::{Arc, mpsc, mpsc::RecvTimeoutError},
    thread,
    time::{Duration, Instant},
};

use marf_cache::{Digest, StoreError};
use marf_stage::{Outputs, Threads, Work};

use super::{
    job::{Job, JobError, JobOutput, Step},
    prepare::prepare_all,
    recover, report,
    state::RunState,
    task::{Phase, Reuse, RunInputs, Task},
};
use crate::{
    errors::contract_violation,
    executor::OtherMachines,
    needs::{Needs, cores_of},
    work::BlobCheck,
};

/// Longest time between two calls of [`crate::StateListener::on_state`].
const STATE_EVERY: Duration = Duration::from_secs(1);

/// Starts jobs on threads of their own, and applies their reports to the state of the run.
pub(super) struct Scheduler<'a> {
    state: RunState<'a>,
    free_permits: usize,
    running: usize,
    /// Which nodes run on other machines.
    elsewhere: BTreeSet<usize>,
}

/// Where a job runs.
#[derive(Debug, Clone, Copy)]
enum Place {
    /// On this many threads of this machine.
    Here(usize),
    /// On another machine.
    Elsewhere,
}

/// The end of a job.
struct JobReport {
    index: usize,
    place: Place,
    result: Result<JobOutput, JobError>,
}

impl<'a> Scheduler<'a> {
    /// Returns a scheduler with as many permits as the run may use threads.
    pub(super) fn new(state: RunState<'a>, threads: usize) -> Self {
        Self {
            state,
            free_permits: threads,
            running: 0,
            elsewhere: BTreeSet::new(),
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
                    && let Some((index, place)) = self.next()
                {
                    let job = self.start(index, place);
                    let sender = sender.clone();
                    scope.spawn(move || {
                        let result = job.map_or_else(|| Err(not_prepared()), Job::execute);
                        // The receiver lives until all jobs have reported.
                        let _ = sender.send(JobReport { index, place, result });
                    });
                }
                if self.running == 0 {
                    return;
                }
                let Some(report) = self.next_report(&receiver) else {
                    return;
                };
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

    /// Waits for the end of a job. Meanwhile the listener receives the state of the run. None if no job is left.
    fn next_report(&self, reports: &mpsc::Receiver<JobReport>) -> Option<JobReport> {
        loop {
            let state = &self.state;
            state.context.listener.on_state(&|| report::record(state).ok());
            match reports.recv_timeout(STATE_EVERY) {
                Ok(report) => return Some(report),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return None,
            }
        }
    }

    /// Returns the first node that may start, and where.
    fn next(&self) -> Option<(usize, Place)> {
        if self.state.context.cancel.is_set() {
            return None;
        }
        self.next_elsewhere().or_else(|| self.next_here())
    }

    /// Returns the first node that another machine takes, if one is free.
    fn next_elsewhere(&self) -> Option<(usize, Place)> {
        let executor = self.state.context.executor?;
        if self.elsewhere.len() >= executor.slots() {
            return None;
        }
        let index = self.state.tasks.iter().position(|task| self.is_taken(task))?;
        Some((index, Place::Elsewhere))
    }

    /// Returns whether another machine takes a node that is ready.
    fn is_taken(&self, task: &Task) -> bool {
        let Some(executor) = self.state.context.executor else {
            return false;
        };
        let takes = |prepared: &RunInputs| {
            let action = &prepared.key.action;
            // What was lost is made again where it can be looked at, if it can be made there.
            let may = task.reuse == Reuse::Allowed || action.backend != task.bound.backend_id();
            may && executor.takes(action)
        };
        let may = task.phase == Phase::Ready && matches!(task.bound.work(), Work::Set(_));
        may && task.prepared.as_ref().is_some_and(takes)
    }

    /// Returns the needs of a node: cores, GPU, memory, time.
    fn needs(&self, task: &Task) -> Needs {
        let context = &self.state.context;
        let key = context.last.and_then(|last| last.latest.get(&task.name));
        let record = key.and_then(|key| context.store.record(key).ok().flatten());
        let backend = task
            .prepared
            .as_ref()
            .and_then(|prepared| prepared.key.action.backend.as_ref());
        let last = record.map(|record| record.metadata);
        Needs::new(task.bound.as_ref(), backend.is_some(), last.as_ref())
    }

    /// Returns the first node that may start here, and its number of permits.
    fn next_here(&self) -> Option<(usize, Place)> {
        if self.free_permits == 0 {
            return None;
        }
        // Two trainings on one GPU would only alternate, with the memory of both.
        let is_on_gpu = |task: &Task| task.bound.backend_id().is_some();
        let tasks = &self.state.tasks;
        let gpu_is_busy = tasks.iter().enumerate().any(|(index, task)| {
            task.phase == Phase::Running && !self.elsewhere.contains(&index) && is_on_gpu(task)
        });
        let is_ready = |task: &&Task| {
            matches!(task.phase, Phase::Ready | Phase::Reducible)
                && !(gpu_is_busy && is_on_gpu(task))
                && !self.is_taken(task)
        };
        let index = tasks.iter().position(|task| is_ready(&task))?;
        let first = &tasks[index];
        // A draft does not share with the trials of a tuning that was declared after it.
        let shares = |task: &&Task| {
            is_ready(task)
                && task.parent.is_some() == first.parent.is_some()
                && cores_of(task.bound.as_ref()) == Threads::All
        };
        let permits = match cores_of(first.bound.as_ref()) {
            Threads::One => 1,
            Threads::All => (self.free_permits / tasks.iter().filter(shares).count()).max(1),
        };
        Some((index, Place::Here(permits)))
    }

    /// Returns the data that a job needs to run on another machine.
    fn elsewhere(&self, index: usize) -> Option<OtherMachines<'a>> {
        let state = &self.state;
        let settled = state.tasks.iter().filter(|task| task.phase.is_good());
        let mut results: Vec<Digest> = settled.filter_map(|task| task.outcome.key).collect();
        results.sort_unstable();
        Some(OtherMachines {
            executor: state.context.executor?,
            needs: self.needs(&state.tasks[index]),
            results,
        })
    }

    /// Takes the permits of a node and returns its job. None if the node was not prepared.
    fn start(&mut self, index: usize, place: Place) -> Option<Job<'a>> {
        self.running += 1;
        let permits = match place {
            Place::Here(permits) => permits,
            Place::Elsewhere => 0,
        };
        self.free_permits -= permits;
        let elsewhere = if matches!(place, Place::Elsewhere) {
            self.elsewhere.insert(index);
            self.elsewhere(index)
        } else {
            None
        };
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
            elsewhere,
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
        self.running -= 1;
        match report.place {
            Place::Here(permits) => self.free_permits += permits,
            Place::Elsewhere => drop(self.elsewhere.remove(&report.index)),
        }
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
