//! Events of running programs, read from the files in which they leave them.
//!
//! ```text
//! FOLDER/<run>.jsonl     a line an event, as `marf run --json` prints them (the first names the pipeline and its nodes)
//! FOLDER/<run>.lock      locked while the program runs
//! ```

use std::fs::File;
use std::io::{self, ErrorKind, Read as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use axum::response::sse::Event;
use marf_cache::Digest;
use marf_cache::file::{Links, open};
use serde_json::Value;
use tokio::sync::mpsc;

use crate::source::Source;

/// Interval between two looks at the files.
const EVERY: Duration = Duration::from_millis(250);
/// Most bytes read at once.
const MOST_BYTES: u64 = 1 << 20;

/// A message to the page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Message {
    /// No program runs, at the beginning or any more.
    Idle,
    /// A line of the file of a running program.
    Line(String),
    /// The run that a page opened now would show.
    Newest(u64),
}

impl Message {
    fn event(&self) -> Event {
        match self {
            Self::Idle => Event::default().event("idle").data("{}"),
            Self::Line(line) => Event::default().event("line").data(line),
            Self::Newest(number) => Event::default().event("newest").data(number.to_string()),
        }
    }
}

/// Sends what happens, from the beginning of the program that runs now, until the receiver is dropped.
pub fn follow(source: Arc<dyn Source>) -> mpsc::Receiver<Result<Event, std::convert::Infallible>> {
    let (sender, receiver) = mpsc::channel(64);
    tokio::spawn(async move {
        let mut follower = Follower::new(source.event_folder());
        let mut newest = None;
        loop {
            let of = Arc::clone(&source);
            let polled = tokio::task::spawn_blocking(move || {
                let messages = follower.poll();
                (follower, messages, of.newest().ok().flatten())
            });
            let Ok((back, mut messages, now)) = polled.await else {
                return;
            };
            follower = back;
            if now != newest {
                newest = now;
                messages.extend(now.map(Message::Newest));
            }
            for message in &messages {
                if sender.send(Ok(message.event())).await.is_err() {
                    return;
                }
            }
            // A page that is gone is noticed even where nothing happens.
            if sender.is_closed() {
                return;
            }
            tokio::time::sleep(EVERY).await;
        }
    });
    receiver
}

/// Returns the events of each program that runs now, a line an event. The program that began last comes
/// first.
pub fn lines_of_running(folder: &Path) -> Vec<Vec<String>> {
    all_running(folder).map(OpenFile::whole).collect()
}

/// Returns whether a node that ended in a program that runs now has this output.
pub fn is_output_of_running(folder: &Path, digest: &Digest) -> bool {
    let digest = digest.to_string();
    let has = |line: &String| {
        // Progress lines are many, and need not be parsed.
        let parse = || serde_json::from_str::<Value>(line).ok();
        let event = line.contains(&digest).then(parse).flatten();
        let event = event.filter(|event| event["event"] == "finished");
        let outputs = event.and_then(|event| event["outputs"].as_object().cloned());
        outputs.is_some_and(|outputs| outputs.values().any(|output| output["digest"] == digest.as_str()))
    };
    lines_of_running(folder).iter().flatten().any(has)
}

/// Follows the program that began last.
struct Follower {
    folder: PathBuf,
    open: Option<OpenFile>,
    is_new: bool,
}

/// A file that is followed.
struct OpenFile {
    file: File,
    lock: PathBuf,
    /// The beginning of a line whose end is not written yet.
    partial: Vec<u8>,
}

impl Follower {
    fn new(folder: PathBuf) -> Self {
        Self {
            folder,
            open: None,
            is_new: true,
        }
    }

    /// Returns the messages since the last call.
    fn poll(&mut self) -> Vec<Message> {
        if self.open.is_none() {
            self.open = all_running(&self.folder).next();
        }
        let Some(open) = &mut self.open else {
            let was_new = std::mem::take(&mut self.is_new);
            return Vec::from_iter(was_new.then_some(Message::Idle));
        };
        self.is_new = false;
        // Looked at before the file is read, so that no line of a program that ends now is missed.
        let has_ended = !is_locked(&open.lock);
        let (lines, is_whole) = open.lines();
        let mut messages: Vec<Message> = lines.into_iter().map(Message::Line).collect();
        if has_ended && is_whole {
            self.open = None;
            messages.push(Message::Idle);
        }
        messages
    }
}

impl OpenFile {
    /// Opens the file of a program.
    fn open(lock: PathBuf) -> Option<Self> {
        Some(Self {
            file: open(&lock.with_extension("jsonl"), Links::Followed).ok()?,
            lock,
            partial: Vec::new(),
        })
    }

    /// Returns all lines up to now.
    fn whole(mut self) -> Vec<String> {
        let mut lines = Vec::new();
        loop {
            let (more, is_whole) = self.lines();
            lines.extend(more);
            if is_whole {
                return lines;
            }
        }
    }

    /// Returns the lines that were added, and whether all was read.
    fn lines(&mut self) -> (Vec<String>, bool) {
        let mut bytes = std::mem::take(&mut self.partial);
        let read = io::copy(&mut (&self.file).take(MOST_BYTES), &mut bytes).unwrap_or_default();
        let whole = bytes
            .iter()
            .rposition(|byte| *byte == b'\n')
            .map_or(0, |end| end + 1);
        self.partial = bytes.split_off(whole);
        let lines = bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
        let text = |line: &[u8]| String::from_utf8_lossy(line).into_owned();
        (lines.map(text).collect(), read < MOST_BYTES)
    }
}

/// Opens the files of the programs that run, those that began last first.
fn all_running(folder: &Path) -> impl Iterator<Item = OpenFile> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let locks = entries
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "lock"));
    let began = |path: &PathBuf| {
        path.metadata()
            .and_then(|data| data.modified())
            .unwrap_or(SystemTime::UNIX_EPOCH)
    };
    let mut locks: Vec<PathBuf> = locks.filter(|path| is_locked(path)).collect();
    locks.sort_by_cached_key(|path| std::cmp::Reverse((began(path), path.clone())));
    locks.into_iter().filter_map(OpenFile::open)
}

/// Returns true if a program holds this file. The tried lock is released at once.
fn is_locked(path: &Path) -> bool {
    let is_none = |kind| {
        [
            ErrorKind::NotFound,
            ErrorKind::PermissionDenied,
            ErrorKind::InvalidInput,
        ]
        .contains(&kind)
    };
    match open(path, Links::Followed).map(|file| file.try_lock_shared()) {
        Ok(Err(std::fs::TryLockError::WouldBlock)) => true,
        Ok(_) => false,
        Err(error) => !is_none(error.kind()),
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    #[test]
    fn lines_of_a_program_are_told_whole_and_once_until_it_ends() {
        let dir = tempfile::tempdir().unwrap();
        let mut follower = Follower::new(dir.path().to_owned());
        assert_eq!(follower.poll(), [Message::Idle]);
        assert_eq!(follower.poll(), []);
        let lock = File::create(dir.path().join("0a.lock")).unwrap();
        lock.lock().unwrap();
        let mut file = File::create(dir.path().join("0a.jsonl")).unwrap();
        write!(file, "{{\"a\":1}}\n{{\"b\"").unwrap();
        let line = |text: &str| Message::Line(text.to_owned());
        assert_eq!(follower.poll(), [line("{\"a\":1}")]);
        assert_eq!(follower.poll(), []);
        writeln!(file, ":2}}").unwrap();
        assert_eq!(follower.poll(), [line("{\"b\":2}")]);
        writeln!(file, "{{\"c\":3}}").unwrap();
        drop(lock);
        assert_eq!(follower.poll(), [line("{\"c\":3}"), Message::Idle]);
        assert_eq!(
            follower.poll(),
            [],
            "the file of a program that was killed is not followed"
        );
    }

    #[test]
    fn of_programs_that_run_at_once_the_one_that_began_last_comes_first() {
        let dir = tempfile::tempdir().unwrap();
        let began = [("0a", 20), ("0b", 30), ("0c", 10), ("dead", 40)];
        let locks: Vec<File> = began
            .iter()
            .map(|(run, seconds)| {
                std::fs::write(dir.path().join(format!("{run}.jsonl")), format!("{run}\n")).unwrap();
                let lock = File::create(dir.path().join(format!("{run}.lock"))).unwrap();
                lock.set_modified(SystemTime::UNIX_EPOCH + Duration::from_secs(*seconds))
                    .unwrap();
                lock
            })
            .collect();
        locks[..3].iter().for_each(|lock| lock.lock().unwrap());
        assert_eq!(lines_of_running(dir.path()), [["0b"], ["0a"], ["0c"]]);
        let mut follower = Follower::new(dir.path().to_owned());
        assert_eq!(follower.poll(), [Message::Line("0b".to_owned())]);
        assert!(lines_of_running(&dir.path().join("nowhere")).is_empty());
    }

    #[test]
    fn an_output_is_served_from_the_end_of_its_node_to_the_end_of_its_program() {
        let dir = tempfile::tempdir().unwrap();
        let lock = File::create(dir.path().join("0a.lock")).unwrap();
        lock.lock().unwrap();
        let [made, key] = [b"made", b"key."].map(|bytes| Digest::from_content(bytes));
        let line = serde_json::json!({
            "event": "finished", "node": "draft", "reason": key, "outputs": {"heldout/a.png": {"digest": made, "bytes": 4}},
        });
        let file = dir.path().join("0a.jsonl");
        std::fs::write(&file, line.to_string().replace("finished", "other") + "\n").unwrap();
        assert!(!is_output_of_running(dir.path(), &made), "its node goes on");
        std::fs::write(&file, format!("{line}\n")).unwrap();
        assert!(is_output_of_running(dir.path(), &made));
        assert!(!is_output_of_running(dir.path(), &key), "only outputs");
        drop(lock);
        assert!(!is_output_of_running(dir.path(), &made), "the program has ended");
    }

    #[test]
    fn a_page_that_comes_later_is_told_all_from_the_beginning() {
        let dir = tempfile::tempdir().unwrap();
        let lock = File::create(dir.path().join("0a.lock")).unwrap();
        lock.lock().unwrap();
        std::fs::write(dir.path().join("0a.jsonl"), "1\n2\n").unwrap();
        for _ in 0..2 {
            let lines = ["1", "2"].map(|text| Message::Line(text.to_owned()));
            assert_eq!(Follower::new(dir.path().to_owned()).poll(), lines);
        }
    }
}
