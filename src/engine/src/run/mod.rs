//! The run: one thread looks on and hands out work, as many work as there are tokens for.
//!
//! Tokens are threads. What needs one takes one; what can use all takes its share of those that are free, hence
//! all when nothing else is ready; one node at a time is on a GPU. How they fall never shows in a result.

mod heal;
mod job;
mod prepare;
mod report;
mod select;
mod task;

use std::{
    collections::BTreeSet,
    num::NonZero,
    sync::{Arc, mpsc},
    thread,
    time::Instant,
};

use marf_cache::{Record, Store, StoreError};
use marf_stage::{Cancel, NodeSpec, Outputs, StageError, Threads};

use self::{
    job::{Done, Fault, Shift, Step, unix_seconds},
    task::{Feed, Phase, Role, Task, Trust},
};
use crate::{
    EngineError, Event, Graph, Listener, RunRecord, last_run,
    photos::bug,
    work::{Check, Counts},
};

/// How to run.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Threads to use; none for as many as there are cores.
    pub threads: Option<NonZero<usize>>,
    /// Run only what leads to these nodes; empty for all.
    pub to: Vec<String>,
    /// Run only these nodes and what depends on them; empty for all.
    pub from: Vec<String>,
    /// Name of the pipeline: a run is compared with the last run of the same name.
    pub pipeline: String,
    /// The command as typed, for the record.
    pub command: String,
    /// The program with version and commit, for the record.
    pub program: String,
}

/// Runs a graph: every node whose key is not in the store, side by side as far as threads go.
///
/// Returns the record, which is in the store by then, also of a run in which nodes failed or which was stopped.
/// A node that fails takes along only those that depend on it; what was computed stays.
///
/// # Errors
/// A name in `to` or `from` that is not there; a store that cannot be used.
pub fn run(
    graph: &Graph,
    store: &Store,
    options: &Options,
    listener: &dyn Listener,
    cancel: &Cancel,
) -> Result<RunRecord, EngineError> {
    let (began, started_unix_s) = (Instant::now(), unix_seconds());
    let last = last_run(store, &options.pipeline)?;
    let roles = select::roles(graph, options)?;
    let cores = || thread::available_parallelism().map_or(1, NonZero::get);
    let threads = options.threads.map_or_else(cores, NonZero::get);
    let site = Site {
        graph,
        store,
        listener,
        cancel,
        program: &options.program,
        last: last.as_ref(),
    };
    let nodes = graph.nodes.iter().zip(roles);
    let mut floor = Floor {
        site,
        tasks: nodes.map(|(node, role)| Task::of_node(node, role)).collect(),
        free: threads,
        running: 0,
    };
    floor.run_all()?;
    floor.tell_stopped();
    let nodes = floor.node_runs()?;
    let mut latest = last.as_ref().map(|run| run.latest.clone()).unwrap_or_default();
    let good = nodes.iter().filter(|node| node.state.is_good());
    latest.extend(good.filter_map(|node| Some((node.name.clone(), node.key?))));
    let record = RunRecord {
        number: 0,
        pipeline: options.pipeline.clone(),
        command: options.command.clone(),
        program: options.program.clone(),
        started_unix_s,
        seconds: began.elapsed().as_secs_f64(),
        outcome: floor.outcome(),
        digest: graph.digest(),
        threads,
        nodes,
        latest,
    };
    record.store(store)
}

/// What every part of a run can see.
#[derive(Clone, Copy)]
pub(crate) struct Site<'a> {
    graph: &'a Graph,
    store: &'a Store,
    listener: &'a dyn Listener,
    cancel: &'a Cancel,
    program: &'a str,
    last: Option<&'a RunRecord>,
}

/// The nodes of a run. Those of the graph come first, in its order; children follow as they are asked for.
struct Floor<'a> {
    site: Site<'a>,
    tasks: Vec<Task>,
    free: usize,
    running: usize,
}

/// A piece of work that came to its end.
struct Report {
    index: usize,
    threads: usize,
    result: Result<Done, Fault>,
}

impl<'a> Floor<'a> {
    /// Runs until nothing is left to do; after a failure of the store it only waits for what is under way.
    fn run_all(&mut self) -> Result<(), StoreError> {
        let (sender, receiver) = mpsc::channel();
        let mut outcome = Ok(());
        thread::scope(|scope| {
            loop {
                if outcome.is_ok() {
                    outcome = self.prepare_all();
                }
                while outcome.is_ok()
                    && let Some((index, threads)) = self.next()
                {
                    let shift = self.shift(index, threads);
                    let sender = sender.clone();
                    let work = move || {
                        let result = shift.map_or_else(|| Err(lost_order()), Shift::work);
                        let report = Report {
                            index,
                            threads,
                            result,
                        };
                        // The receiver lives until all have reported.
                        let _ = sender.send(report);
                    };
                    scope.spawn(work);
                }
                if self.running == 0 {
                    return;
                }
                let Ok(report) = receiver.recv() else { return };
                let taken = self.take(report);
                if outcome.is_ok() {
                    outcome = taken;
                }
            }
        });
        outcome
    }

    /// Returns the next node to work on, and how many threads it gets.
    fn next(&self) -> Option<(usize, usize)> {
        if self.free == 0 || self.site.cancel.is_set() {
            return None;
        }
        // A GPU is one token: two trainings on it would only take turns, with the memory of both.
        let is_on_gpu = |task: &Task| task.bound.backend_id().is_some();
        let mut running = self
            .tasks
            .iter()
            .filter(|task| matches!(task.phase, Phase::Running));
        let is_busy = running.any(is_on_gpu);
        let is_ready = |task: &&Task| {
            matches!(task.phase, Phase::Ready | Phase::Reducible) && !(is_busy && is_on_gpu(task))
        };
        let ready = self.tasks.iter().filter(is_ready).count();
        let index = self.tasks.iter().position(|task| is_ready(&task))?;
        let threads = match self.tasks[index].bound.threads() {
            Threads::One => 1,
            Threads::All => (self.free / ready).max(1),
        };
        Some((index, threads))
    }

    fn shift(&mut self, index: usize, threads: usize) -> Option<Shift<'a>> {
        self.free -= threads;
        self.running += 1;
        let step = match self.tasks[index].phase {
            Phase::Reducible => self.reduction(index),
            _ => Step::Start,
        };
        let task = &mut self.tasks[index];
        if matches!(step, Step::Start) {
            task.began = None;
            task.tries += 1;
        }
        task.phase = Phase::Running;
        Some(Shift {
            site: self.site,
            node: task.name.clone(),
            def: task.def,
            bound: Arc::clone(&task.bound),
            order: task.order.clone()?,
            step,
            check: match task.trust {
                Trust::Stored => Check::Names,
                Trust::Nothing => Check::Blobs,
            },
            threads,
            began: *task.began.get_or_insert_with(Instant::now),
        })
    }

    fn reduction(&self, index: usize) -> Step {
        let children = || self.tasks[index].children.iter().map(|&child| &self.tasks[child]);
        let outputs: Vec<Outputs> = children().map(Task::outputs).collect();
        let prefix = self.tasks[index].name.len() + 1;
        let keys = children().filter_map(|child| Some((child.name[prefix..].to_owned(), child.told.key?)));
        Step::Reduce(outputs, keys.collect())
    }

    fn take(&mut self, report: Report) -> Result<(), StoreError> {
        self.free += report.threads;
        self.running -= 1;
        let index = report.index;
        match report.result {
            Ok(Done::Reused(record)) => self.reuse(index, *record),
            Ok(Done::Finished(record, counts)) => self.finish(index, *record, counts),
            Ok(Done::Expanded(specs)) => self.expand(index, specs),
            Err(Fault::Store(error)) => {
                self.tasks[index].phase = Phase::Stopped;
                return Err(error);
            }
            Err(Fault::Stage(error)) => match self.can_heal(index, &error) {
                Some(lost) => self.heal(index, &lost),
                None => self.fail(index, error),
            },
        }
        Ok(())
    }

    fn finish(&mut self, index: usize, record: Record, counts: Counts) {
        let task = &mut self.tasks[index];
        task.phase = Phase::Finished;
        task.told.seconds = record.metadata.seconds;
        task.told.outputs = record.outputs;
        task.told.counts = counts;
        self.site.listener.on_event(&Event::Finished {
            node: task.name.clone(),
            seconds: task.told.seconds,
            outputs: task.told.outputs.clone(),
            counts: task.told.counts.clone(),
        });
        self.child_settled(index);
    }

    /// Adds the nodes that a node asked for.
    fn expand(&mut self, index: usize, specs: Vec<NodeSpec>) {
        let mut children = Vec::new();
        let mut names = BTreeSet::new();
        for spec in specs {
            match self.child(index, spec) {
                Ok(child) if names.insert(child.name.clone()) => children.push(child),
                Ok(child) => return self.fail(index, bug(format!("it asks for `{}` twice", child.name))),
                Err(error) => return self.fail(index, error),
            }
        }
        let first = self.tasks.len();
        self.tasks[index].children = (first..first + children.len()).collect();
        self.tasks[index].phase = match children.is_empty() {
            true => Phase::Reducible,
            false => Phase::Expanding,
        };
        self.tasks.extend(children);
    }

    fn child(&self, parent: usize, spec: NodeSpec) -> Result<Task, StageError> {
        let name = format!("{}/{}", self.tasks[parent].name, spec.name);
        let Some(def) = self.site.graph.table.get(spec.stage.as_str()) else {
            return Err(bug(format!(
                "`{name}` is of the stage `{}`, which is not there",
                spec.stage
            )));
        };
        let bound = (def.bind)(spec.params).map_err(|error| {
            let path = match error.path.is_empty() {
                true => name.clone(),
                false => format!("{name}.{}", error.path),
            };
            StageError::new(format!("`{path}`: {error}"))
        })?;
        Ok(Task {
            parent: Some(parent),
            ..Task::new(name, *def, Arc::from(bound), Feed::Fixed(spec.inputs))
        })
    }

    /// Tells a node that asked for others how far they are, and goes on with it when all have settled.
    fn child_settled(&mut self, index: usize) {
        let Some(parent) = self.tasks[index].parent else {
            return;
        };
        if self.tasks[parent].phase != Phase::Expanding {
            return;
        }
        let phases: Vec<Phase> = self.tasks[parent]
            .children
            .iter()
            .map(|&child| self.tasks[child].phase)
            .collect();
        let settled = phases.iter().filter(|phase| phase.is_settled()).count();
        self.site.listener.on_event(&Event::Progress {
            node: self.tasks[parent].name.clone(),
            done: settled as u64,
            total: phases.len() as u64,
            note: String::new(),
        });
        if settled < phases.len() {
            return;
        }
        let bad: Vec<usize> = (0..phases.len())
            .filter(|&child| !phases[child].is_good())
            .collect();
        match bad.first() {
            None => self.tasks[parent].phase = Phase::Reducible,
            Some(_) if phases.contains(&Phase::Stopped) => self.fail(parent, StageError::Cancelled),
            Some(&first) => {
                let name = &self.tasks[self.tasks[parent].children[first]].name;
                let message = format!(
                    "{} of {} of its nodes failed, first `{name}`",
                    bad.len(),
                    phases.len()
                );
                self.fail(parent, StageError::new(message));
            }
        }
    }

    fn tell_stopped(&mut self) {
        for task in self.tasks.iter_mut().filter(|task| task.role == Role::Run) {
            if task.phase == Phase::Stopped || !task.phase.is_settled() {
                task.phase = Phase::Stopped;
                task.told.reason = "the run was stopped".to_owned();
                self.site.listener.on_event(&Event::Skipped {
                    node: task.name.clone(),
                    reason: task.told.reason.clone(),
                });
            }
        }
    }
}

fn lost_order() -> Fault {
    Fault::Stage(bug("it was started before it was ready".to_owned()))
}
