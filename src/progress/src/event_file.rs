//! Leaves the events of a run in the store, where `marf view` reads them while it goes on.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use marf_cache::Store;
use marf_cache::file::{Links, open};
use marf_engine::{Event, Listener, RunSource};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};

use super::estimate::RunProgress;
use super::json::Line;

/// Shortest time between two lines of progress of a node, except the last one.
const PROGRESS_EVERY: Duration = Duration::from_millis(500);

/// Returns the folder in which running programs write their events: `<run>.jsonl`, a line an event, with `<run>.lock`, which is
/// locked while the program runs. Nothing in it is in any key or result.
pub fn event_folder(store: &Store) -> PathBuf {
    store.scratch().join("events")
}

/// A file with the events of a run, which is removed at its end.
pub struct EventFile {
    run: String,
    path: PathBuf,
    /// Locked as long as it is open.
    lock: Option<File>,
    state: Mutex<State>,
}

struct State {
    file: File,
    last_progress: HashMap<String, Instant>,
}

/// A line of the file.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum EventLine {
    /// The first.
    Began(RunStart),
    /// How far the whole run is.
    Standing {
        /// In numbers.
        #[serde(flatten)]
        standing: RunProgress,
        /// The same in words.
        text: String,
    },
    /// An event, which is written as a [`Line`].
    #[serde(untagged)]
    Event(Event),
}

/// The start of a run.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct RunStart {
    /// Name of the run.
    pub run: String,
    /// Name of the pipeline.
    pub pipeline: String,
    /// What it is a run of.
    pub source: RunSource,
    /// The command as typed.
    pub command: String,
    /// The nodes, producers first.
    pub nodes: Vec<String>,
    /// Inputs of each node, by name. Nodes without inputs are left out.
    pub upstream: BTreeMap<String, Vec<String>>,
}

impl EventFile {
    /// Begins a file, and removes those of programs that were killed.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn create(folder: &Path, start: RunStart) -> io::Result<Self> {
        std::fs::create_dir_all(folder)?;
        remove_dead(folder);
        let run = start.run.clone();
        let path = folder.join(format!("{run}.jsonl"));
        let mut file = File::create(&path)?;
        writeln!(file, "{}", serde_json::to_string(&EventLine::Began(start))?)?;
        let lock = File::create(path.with_extension("lock"))?;
        lock.lock()?;
        Ok(Self {
            run,
            path,
            lock: Some(lock),
            state: Mutex::new(State {
                file,
                last_progress: HashMap::new(),
            }),
        })
    }
}

impl EventFile {
    /// Adds how far the whole run is.
    pub fn on_run_progress(&self, standing: &RunProgress) {
        let line = EventLine::Standing {
            text: standing.text(),
            standing: standing.clone(),
        };
        if let Ok(line) = serde_json::to_string(&line) {
            let _ = self.state.lock().file.write_all(format!("{line}\n").as_bytes());
        }
    }
}

impl State {
    fn is_due(&mut self, event: &Event) -> bool {
        let Event::Progress {
            node, done, total, ..
        } = event
        else {
            return true;
        };
        let last = self.last_progress.get(node);
        let due = done == total || last.is_none_or(|last| last.elapsed() >= PROGRESS_EVERY);
        if due {
            self.last_progress.insert(node.clone(), Instant::now());
        }
        due
    }
}

impl Listener for EventFile {
    fn on_event(&self, event: &Event) {
        let mut state = self.state.lock();
        if !state.is_due(event) {
            return;
        }
        if let Ok(line) = serde_json::to_string(&Line::now(&self.run, event)) {
            // A full disk fails the run at a more important write. A page may miss a line.
            let _ = state.file.write_all(format!("{line}\n").as_bytes());
        }
    }
}

impl Drop for EventFile {
    fn drop(&mut self) {
        drop(self.lock.take());
        remove(&self.path);
    }
}

/// Removes the files of programs that do not run any more.
fn remove_dead(folder: &Path) {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    for lock in entries.map(|entry| entry.path()) {
        let is_lock = lock.extension().is_some_and(|ending| ending == "lock");
        if is_lock && open(&lock, Links::Followed).is_ok_and(|file| file.try_lock().is_ok()) {
            remove(&lock.with_extension("jsonl"));
        }
    }
}

/// Removes a file with its lock. If that fails, a later run removes them.
fn remove(path: &Path) {
    let _ = std::fs::remove_file(path);
    let _ = std::fs::remove_file(path.with_extension("lock"));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn began(run: &str) -> RunStart {
        RunStart {
            run: run.to_owned(),
            pipeline: "demo".to_owned(),
            command: "marf run".to_owned(),
            ..RunStart::default()
        }
    }

    #[test]
    fn events_are_lines_with_little_progress_and_nothing_stays_at_the_end() {
        let dir = tempfile::tempdir().unwrap();
        let events = EventFile::create(dir.path(), began("0a")).unwrap();
        for done in 1..=100 {
            events.on_event(&Event::Progress {
                node: "extract".to_owned(),
                done,
                total: 100,
                note: String::new(),
            });
        }
        let text = std::fs::read_to_string(dir.path().join("0a.jsonl")).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert!(
            lines[0].starts_with(r#"{"event":"began","run":"0a","pipeline":"demo""#),
            "{text}"
        );
        assert!(lines[1].contains(r#""done":1,"total":100"#), "{text}");
        assert!(lines.last().unwrap().contains(r#""done":100,"#), "{text}");
        assert!(lines.len() < 10, "{} lines", lines.len());
        drop(events);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    #[test]
    fn files_of_killed_programs_are_removed_and_those_of_running_ones_stay() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["dead.jsonl", "dead.lock"] {
            std::fs::write(dir.path().join(name), "").unwrap();
        }
        let _running = EventFile::create(dir.path(), began("0a")).unwrap();
        let _next = EventFile::create(dir.path(), began("0b")).unwrap();
        let there = |name: &str| dir.path().join(name).exists();
        assert!(!there("dead.jsonl") && !there("dead.lock") && there("0a.jsonl") && there("0b.lock"));
    }
}
