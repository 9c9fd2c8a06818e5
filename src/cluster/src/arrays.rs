//! Arrays: parts of a node as the tasks of few jobs. What was submitted is written down, so that the next run takes over what still
//! waits or runs.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    path::PathBuf,
    time::Instant,
};

use marf_cache::Digest;
use marf_cache::file::{self, FileKind, Links};
use marf_engine::{Order, PartOrder};
use marf_stage::{StageError, Threads, format};

use crate::{
    array_plan::{Array, Plan, PlannedArray, Task, array_files},
    cluster::{Cluster, KEYS_AT_ONCE},
    commands::{count, tasks_of},
    errors::{failed, remote_failed},
    job_files::JobFiles,
    job_result::{JobResult, write_whole},
    queue::{ATTEMPTS, JobState},
    script::{Filling, filled, shell_quoted},
    words::{in_short, memory},
};

/// The parts of a node, from their submission to their results.
pub(crate) struct Arrays<'a> {
    cluster: &'a Cluster,
    order: &'a Order<'a>,
    tasks: Vec<Task>,
    arrays: Vec<Array>,
}

impl<'a> Arrays<'a> {
    pub(crate) fn new(cluster: &'a Cluster, order: &'a Order<'a>) -> Self {
        Self {
            cluster,
            order,
            tasks: Vec::new(),
            arrays: Vec::new(),
        }
    }

    /// Has parts computed, and brings their results.
    pub(crate) fn run(mut self, parts: &[PartOrder]) -> Result<(), StageError> {
        let lacking = self.lacking(parts)?;
        if lacking.is_empty() {
            return Ok(());
        }
        self.cluster.share(self.order)?;
        let planned = self.adopt(&lacking);
        let new: Vec<&PartOrder> = lacking
            .into_iter()
            .filter(|part| !planned.contains(&part.key))
            .collect();
        let first = self.tasks.len();
        self.group(&new).map_err(|error| self.unwritten(&error))?;
        let memory_mb = self.cluster.memory_mb(&self.order.needs);
        let ended = self
            .submit((first..self.tasks.len()).collect(), memory_mb)
            .and_then(|()| self.wait());
        match ended {
            Ok(()) => self.remove_files(),
            Err(_) => self.cancel(),
        }
        ended
    }

    /// Returns the parts whose results are neither here nor in the shared store.
    fn lacking<'p>(&self, parts: &'p [PartOrder]) -> Result<Vec<&'p PartOrder>, StageError> {
        let order = self.order;
        let lacks = |part: &&PartOrder| order.store.hit(&part.key).is_ok_and(|record| record.is_none());
        let absent: Vec<Digest> = parts.iter().filter(lacks).map(|part| part.key).collect();
        let fetched = self.cluster.fetch_known(order, &absent);
        fetched.map_err(|error| remote_failed(order.node, "results cannot be fetched", error))?;
        Ok(parts.iter().filter(lacks).collect())
    }

    /// Takes over the tasks that an earlier run has submitted. Returns the keys of their parts.
    fn adopt(&mut self, wanted: &[&PartOrder]) -> BTreeSet<Digest> {
        let wanted: BTreeSet<Digest> = wanted.iter().map(|part| part.key).collect();
        let plan: Plan = file::read(&self.plan_path(), FileKind::Document, Links::Refused)
            .ok()
            .and_then(|bytes| serde_json::from_slice(&bytes).ok())
            .unwrap_or_default();
        // A task that was submitted again is where it was last.
        let mut places: BTreeMap<Digest, (usize, usize)> = BTreeMap::new();
        for (number, planned) in plan.arrays.into_iter().enumerate() {
            let tasks = planned.tasks.iter().enumerate();
            places.extend(tasks.map(|(index, key)| (*key, (number, index))));
            self.arrays.push(Array {
                planned,
                since: self.cluster.began,
                id: None,
            });
        }
        let mut taken = BTreeSet::new();
        for (key, (array, index)) in places {
            let Ok(actions) = file::read(&self.files(&key).action, FileKind::Document, Links::Refused) else {
                continue;
            };
            let parts: Vec<Digest> = actions
                .split(|byte| *byte == b'\n')
                .map(Digest::from_content)
                .collect();
            if Digest::from_content(&actions) == key && parts.iter().any(|part| wanted.contains(part)) {
                taken.extend(&parts);
                self.tasks.push(Task {
                    is_adopted: true,
                    array,
                    index,
                    ..Task::new(key, parts)
                });
            } else if self.files(&key).result.exists() {
                // Its results were brought before.
                self.files(&key).remove();
            }
        }
        taken
    }

    /// Writes the actions of new tasks: parts in their order, as many a task as the site says.
    fn group(&mut self, parts: &[&PartOrder]) -> io::Result<()> {
        let mut photos = 0;
        let mut group: Vec<&PartOrder> = Vec::new();
        for (at, part) in parts.iter().enumerate() {
            group.push(part);
            photos += part.photos;
            if photos >= self.cluster.site.photos_per_task || at + 1 == parts.len() {
                self.add_task(&group)?;
                (photos, group) = (0, Vec::new());
            }
        }
        Ok(())
    }

    fn add_task(&mut self, parts: &[&PartOrder]) -> io::Result<()> {
        let lines: Vec<&[u8]> = parts.iter().map(|part| part.action.as_slice()).collect();
        let actions = lines.join(&b'\n');
        let key = Digest::from_content(&actions);
        let files = self.files(&key);
        match fs::remove_file(&files.result) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => fs::write(&files.action, actions)?,
        }
        let keys = parts.iter().map(|part| part.key).collect();
        self.tasks.push(Task::new(key, keys));
        Ok(())
    }

    /// Submits tasks, as arrays of no more than the batch system takes.
    fn submit(&mut self, tasks: Vec<usize>, memory_mb: u64) -> Result<(), StageError> {
        for chunk in tasks.chunks(self.cluster.site.max_array) {
            let keys = chunk.iter().map(|&task| self.tasks[task].key);
            let planned = PlannedArray::new(keys.collect(), memory_mb);
            for (index, &task) in chunk.iter().enumerate() {
                self.tasks[task].array = self.arrays.len();
                self.tasks[task].index = index;
            }
            self.arrays.push(Array {
                planned,
                since: Instant::now(),
                id: None,
            });
            self.keep_plan().map_err(|error| self.unwritten(&error))?;
            self.submit_last()?;
        }
        Ok(())
    }

    /// Submits the last array. If the batch system is busy, tries again.
    fn submit_last(&mut self) -> Result<(), StageError> {
        let Some(array) = self.arrays.last() else {
            return Ok(());
        };
        let script = || self.write(&array.planned);
        let (node, cancel) = (self.order.node, self.order.cancel);
        let job = self.cluster.job(node, cancel, &array.planned.name, &script)?;
        if let Some(array) = self.arrays.last_mut() {
            let (id, _) = tasks_of(&job.id);
            (array.id, array.since) = (Some(id.to_owned()), job.since);
        }
        Ok(())
    }

    /// Writes the script of an array and the list of its tasks.
    fn write(&self, array: &PlannedArray) -> io::Result<PathBuf> {
        let (site, folder) = (&self.cluster.site, &self.cluster.site.folder);
        let [script, list] = array_files(folder, &array.name);
        let stem = |key: &Digest| self.files(key).scratch.display().to_string() + "\n";
        fs::write(&list, array.tasks.iter().map(stem).collect::<String>())?;
        let index = &site.array_index;
        let list = shell_quoted(&list.display().to_string());
        let lines = [
            format!("task=$(sed -n \"$(({index} + 1))p\" {list})"),
            "exec >> \"$task.log\" 2>&1".to_owned(),
        ];
        let last = (array.tasks.len() - 1).to_string();
        let most = site.max_jobs.to_string();
        let of_array = site.array_options.iter();
        let of_array = of_array.map(|option| option.replace("{last}", &last).replace("{max_jobs}", &most));
        let options: Vec<String> = site.options.iter().cloned().chain(of_array).collect();
        let filling = Filling {
            name: &array.name,
            task: &lines.join("\n"),
            action: "\"$task.action\"".to_owned(),
            store: &site.store,
            marf: &self.cluster.marf,
            log: &script.with_extension("log"),
            result: "\"$task.json\"".to_owned(),
            scratch: "\"$task\"".to_owned(),
            cores: match self.order.needs.cores {
                Threads::One => 1,
                Threads::All => site.cores,
            },
            memory_mb: array.memory_mb,
            minutes: site.minutes,
            options: &options,
        };
        fs::write(&script, filled(&self.cluster.script, &filling))?;
        Ok(script)
    }

    /// Waits until all tasks have reported their end. Lost ones are submitted again.
    fn wait(&mut self) -> Result<(), StageError> {
        loop {
            self.collect()?;
            if self.tasks.iter().all(|task| task.is_done) {
                return Ok(());
            }
            if self.order.cancel.is_set() {
                return Err(StageError::Cancelled);
            }
            let lost = self.look();
            self.submit_again(lost)?;
            self.cluster.rest(self.order.cancel);
        }
    }

    /// Brings the results of tasks that have ended since the last look.
    fn collect(&mut self) -> Result<(), StageError> {
        let order = self.order;
        let files = fs::read_dir(&self.cluster.site.folder).map_err(|error| self.unwritten(&error))?;
        let names: BTreeSet<_> = files.flatten().map(|file| file.file_name()).collect();
        let mut ended = Vec::new();
        for (at, task) in self.tasks.iter().enumerate().filter(|(_, task)| !task.is_done) {
            let result = self.files(&task.key).result;
            if !result.file_name().is_some_and(|name| names.contains(name)) {
                continue;
            }
            if let Some(result) = JobResult::read(&result, &task.key) {
                self.cluster.outcome(order.progress, result)?;
                ended.push(at);
            }
        }
        let keys: Vec<Digest> = ended
            .iter()
            .flat_map(|&at| self.tasks[at].parts.clone())
            .collect();
        for some in keys.chunks(KEYS_AT_ONCE) {
            self.cluster.bring_told(order, some)?;
        }
        ended.into_iter().for_each(|at| self.tasks[at].is_done = true);
        Ok(())
    }

    /// Shows what the batch system says, and returns the tasks that are lost.
    fn look(&mut self) -> Vec<usize> {
        let cluster = self.cluster;
        let (mut running, mut waiting, mut said) = (0, 0, String::new());
        let mut lost = Vec::new();
        for number in 0..self.arrays.len() {
            if !self
                .tasks
                .iter()
                .any(|task| !task.is_done && task.array == number)
            {
                continue;
            }
            let array = &mut self.arrays[number];
            let state = cluster.queue.look(
                &cluster.site.commands,
                &array.planned.name,
                array.since,
                self.order.cancel,
            );
            let live = match state {
                JobState::Unknown(fault) => {
                    said = fault;
                    continue;
                }
                JobState::Absent => Vec::new(),
                JobState::Listed(listed, _) => listed,
            };
            let mut ranges = Vec::new();
            for job in &live {
                let (id, numbers) = tasks_of(&job.id);
                array.id.get_or_insert_with(|| id.to_owned());
                let count = count(&numbers);
                if job.is_running() {
                    running = count.saturating_add(running);
                } else {
                    (waiting, said) = (count.saturating_add(waiting), job.reason.clone());
                }
                ranges.extend(numbers);
            }
            lost.extend(self.lost_of(number, |index| ranges.iter().any(|range| range.contains(&index))));
        }
        self.show(running, waiting, &said);
        lost
    }

    /// Returns the tasks of an array that have been in neither the queue nor the folder for too long.
    fn lost_of(&mut self, number: usize, is_live: impl Fn(usize) -> bool) -> Vec<usize> {
        let patience = self.cluster.patience();
        let mut lost = Vec::new();
        for (at, task) in self.tasks.iter_mut().enumerate() {
            if task.is_done || task.array != number {
                continue;
            }
            if is_live(task.index) {
                (task.is_adopted, task.absent_since) = (false, None);
            } else if task.is_adopted
                || task.absent_since.get_or_insert_with(Instant::now).elapsed() >= patience
            {
                lost.push(at);
            }
        }
        lost
    }

    fn show(&self, running: usize, waiting: usize, said: &str) {
        let parts = |tasks: &mut dyn Iterator<Item = &Task>| tasks.map(|task| task.parts.len() as u64).sum();
        let total: u64 = parts(&mut self.tasks.iter());
        let done: u64 = parts(&mut self.tasks.iter().filter(|task| task.is_done));
        let mut note = format!("{} running, {waiting} waiting", format::count(running, "task"));
        if !said.is_empty() {
            note.push_str(&format!(" ({})", in_short(said)));
        }
        self.order.progress.at(done, total, &note);
    }

    /// Submits lost tasks again, with twice the memory where one had too little.
    fn submit_again(&mut self, lost: Vec<usize>) -> Result<(), StageError> {
        let mut by_memory: BTreeMap<u64, Vec<usize>> = BTreeMap::new();
        for at in lost {
            let Task {
                array: number, index, ..
            } = self.tasks[at];
            let array = &self.arrays[number];
            let said = array.id.as_ref().map_or_else(String::new, |id| {
                let task = format!("{id}_{index}");
                self.cluster.site.commands.explain(&task, self.order.cancel)
            });
            let had = array.planned.memory_mb;
            let memory_mb = if said.contains("OUT_OF_MEMORY") {
                had.saturating_mul(2)
            } else {
                had
            };
            let task = &mut self.tasks[at];
            task.attempts_left -= 1;
            (task.is_adopted, task.absent_since) = (false, None);
            if task.attempts_left == 0 {
                return Err(self.lost(at, &said));
            }
            by_memory.entry(memory_mb).or_default().push(at);
        }
        for (memory_mb, tasks) in by_memory {
            self.order.progress.warn(&format!(
                "{} ended without a result, submitted again with {}",
                format::count(tasks.len(), "task"),
                memory(memory_mb)
            ));
            self.submit(tasks, memory_mb)?;
        }
        Ok(())
    }

    fn lost(&self, at: usize, said: &str) -> StageError {
        let task = &self.tasks[at];
        let files = self.files(&task.key);
        let error = StageError::new(format!(
            "`{}`: a task of {} ended {ATTEMPTS} times without a result ({})",
            self.order.node,
            format::count(task.parts.len(), "shard"),
            in_short(said),
        ));
        let error = match files.log_tail() {
            Some(tail) => error.cause(tail),
            None => error,
        };
        error.hint(format!(
            "see {}. `memory_mb`, `minutes` and `photos_per_task` of the site file limit a task",
            files.log.display()
        ))
    }

    /// Removes all waiting and running jobs from the queue.
    fn cancel(&mut self) {
        if self.arrays.iter().any(|array| array.id.is_none()) {
            self.look();
        }
        for array in &self.arrays {
            if let Some(id) = &array.id
                && let Err(said) = self.cluster.site.commands.cancel(id)
            {
                self.order
                    .progress
                    .warn(&format!("job {id} cannot be stopped: {said}"));
            }
        }
    }

    fn remove_files(&self) {
        for task in &self.tasks {
            self.files(&task.key).remove();
        }
        for array in &self.arrays {
            let [script, list] = array_files(&self.cluster.site.folder, &array.planned.name);
            let log = script.with_extension("log");
            for file in [script, list, log] {
                let _ = fs::remove_file(file);
            }
        }
        let _ = fs::remove_file(self.plan_path());
    }

    fn keep_plan(&self) -> io::Result<()> {
        let arrays = self.arrays.iter().map(|array| array.planned.clone()).collect();
        write_whole(&self.plan_path(), &Plan { arrays })
    }

    fn plan_path(&self) -> PathBuf {
        self.cluster
            .site
            .folder
            .join(format!("{}.arrays", self.order.key))
    }

    fn files(&self, key: &Digest) -> JobFiles {
        JobFiles::new(&self.cluster.site.folder, key)
    }

    fn unwritten(&self, error: &io::Error) -> StageError {
        failed(self.order.node, "the files of its jobs cannot be written", error)
    }
}
