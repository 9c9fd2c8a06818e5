//! The commands of a batch system.

use std::{
    collections::BTreeMap,
    io::{self, Read as _},
    ops::RangeInclusive,
    process::{Command, Output, Stdio},
    time::{Duration, Instant},
};

use serde::Deserialize;

/// Longest wait for an answer of the batch system.
const ANSWER_PATIENCE: Duration = Duration::from_secs(60);
/// Most bytes of an answer: a queue of a million jobs has 100 MB.
const MOST_ANSWER_BYTES: u64 = 256 << 20;

/// Pause between two looks whether it has answered.
const ANSWER_INTERVAL: Duration = Duration::from_millis(10);

/// Any number of a task.
const ALL: [RangeInclusive<usize>; 1] = [0..=usize::MAX];

/// Commands of a batch system, each a program with its arguments. The default is Slurm. `{script}` is the script of a job, `{id}` the
/// id that the batch system gave it.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Commands {
    /// Submits a job. Prints its id first.
    pub submit: Vec<String>,
    /// Lists the jobs of the user that wait or run, one a line: `id|name|state|reason`.
    pub list: Vec<String>,
    /// Takes a job out of the queue, or stops it with SIGTERM.
    pub cancel: Vec<String>,
    /// Explains how a job that is gone ended, in any words. `OUT_OF_MEMORY` among them doubles its memory.
    pub explain: Vec<String>,
}

impl Default for Commands {
    fn default() -> Self {
        let words = |text: &str| text.split(' ').map(str::to_owned).collect();
        Self {
            submit: words("sbatch --parsable {script}"),
            list: words("squeue --me --noheader --format=%i|%j|%T|%r"),
            cancel: words("scancel {id}"),
            explain: words("scontrol --oneliner show job {id}"),
        }
    }
}

/// A job that the batch system has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ListedJob {
    pub id: String,
    /// Its state in the words of the batch system, in small letters.
    pub state: String,
    /// Why it waits. Empty if it does not.
    pub reason: String,
}

impl ListedJob {
    pub(crate) fn is_running(&self) -> bool {
        matches!(self.state.as_str(), "running" | "completing")
    }
}

impl Commands {
    pub(crate) fn check(&self) -> Result<(), (&'static str, String)> {
        for (key, command) in [
            ("commands.submit", &self.submit),
            ("commands.list", &self.list),
            ("commands.cancel", &self.cancel),
            ("commands.explain", &self.explain),
        ] {
            if command.is_empty() {
                return Err((key, "no program".to_owned()));
            }
        }
        Ok(())
    }

    /// Submits a job, and returns its id.
    pub(crate) fn submit(&self, script: &str) -> Result<String, String> {
        let printed = run(&self.submit, "{script}", script)?;
        // Slurm adds `;cluster` on sites with several.
        let id = printed.split([';', '\n']).next().unwrap_or_default().trim();
        if is_id(id) {
            Ok(id.to_owned())
        } else {
            Err(format!("`{}` printed no id of a job: {id:?}", self.submit[0]))
        }
    }

    /// Returns the jobs of the user by name. The tasks of an array have the same name.
    pub(crate) fn list(&self) -> Result<BTreeMap<String, Vec<ListedJob>>, String> {
        let printed = run(&self.list, "", "")?;
        let mut jobs: BTreeMap<String, Vec<ListedJob>> = BTreeMap::new();
        for (name, job) in printed.lines().filter_map(listed) {
            jobs.entry(name).or_default().push(job);
        }
        Ok(jobs)
    }

    /// Takes a job out of the queue.
    pub(crate) fn cancel(&self, id: &str) -> Result<(), String> {
        run(&self.cancel, "{id}", id).map(drop)
    }

    /// Returns the explanation of the batch system for a job that is gone, or an empty text if it has
    /// forgotten the job.
    pub(crate) fn explain(&self, id: &str) -> String {
        run(&self.explain, "{id}", id).unwrap_or_default()
    }
}

/// Returns whether a text can be the id of a job: commands of a site file may pass it to a shell.
fn is_id(text: &str) -> bool {
    !text.is_empty()
        && text
            .chars()
            .all(|char| char.is_ascii_alphanumeric() || "._-+:@%,[]".contains(char))
}

/// Reads a line `id|name|state|reason`.
fn listed(line: &str) -> Option<(String, ListedJob)> {
    let mut parts = line.trim().splitn(4, '|');
    let mut next = || parts.next().map(|part| part.trim().to_owned());
    let (id, name, state) = (next().filter(|id| is_id(id))?, next()?, next()?);
    let reason = next().unwrap_or_default();
    let listed = ListedJob {
        id,
        state: state.to_lowercase(),
        reason: match reason.as_str() {
            "None" => String::new(),
            _ => reason,
        },
    };
    Some((name, listed))
}

/// Splits the id of tasks of an array (`12_[0-3,7%5]`, `12_4`) into the id of the array and the numbers of the tasks. Returns all
/// numbers if none can be read.
pub(crate) fn tasks_of(id: &str) -> (&str, Vec<RangeInclusive<usize>>) {
    let Some((array, tasks)) = id.split_once('_') else {
        return (id, ALL.to_vec());
    };
    let tasks = tasks.trim_start_matches('[').trim_end_matches(']');
    let tasks = tasks.split_once('%').map_or(tasks, |(tasks, _)| tasks);
    let range = |range: &str| {
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        Some(first.parse().ok()?..=last.parse().ok()?)
    };
    let ranges: Option<Vec<_>> = tasks.split(',').map(range).collect();
    (array, ranges.unwrap_or_else(|| ALL.to_vec()))
}

/// Returns the number of tasks, or 1 if they are not listed one by one.
pub(crate) fn count(tasks: &[RangeInclusive<usize>]) -> usize {
    if tasks == ALL {
        1
    } else {
        tasks.iter().map(|range| range.clone().count()).sum()
    }
}

/// Runs a command, and returns what it printed.
fn run(command: &[String], placeholder: &str, value: &str) -> Result<String, String> {
    let filled = |word: &String| {
        if placeholder.is_empty() {
            word.clone()
        } else {
            word.replace(placeholder, value)
        }
    };
    let words: Vec<String> = command.iter().map(filled).collect();
    let output = output(&words).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => format!("there is no program `{}`", words[0]),
        _ => format!("`{}`: {error}", words[0]),
    })?;
    if output.status.success() {
        Ok(String::from_utf8_lossy(&output.stdout).into_owned())
    } else {
        let said = String::from_utf8_lossy(&output.stderr);
        Err(format!("`{}` says: {}", words[0], said.trim()))
    }
}

/// Runs a command to its end. A command that does not answer is stopped.
fn output(words: &[String]) -> io::Result<Output> {
    let mut child = Command::new(&words[0])
        .args(&words[1..])
        // Slurm cuts the numbers of the tasks of an array else.
        .env("SLURM_BITSTR_LEN", "0")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()?;
    let began = Instant::now();
    // What these commands print fits a pipe, but for a long queue: it is read while they run.
    let read = |from: Option<Box<dyn io::Read + Send>>| {
        std::thread::spawn(move || {
            let mut bytes = Vec::new();
            from.map(|from| io::copy(&mut from.take(MOST_ANSWER_BYTES), &mut bytes));
            bytes
        })
    };
    let stdout = read(child.stdout.take().map(|pipe| Box::new(pipe) as _));
    let stderr = read(child.stderr.take().map(|pipe| Box::new(pipe) as _));
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        if began.elapsed() > ANSWER_PATIENCE {
            child.kill()?;
            child.wait()?;
            let seconds = ANSWER_PATIENCE.as_secs();
            return Err(io::Error::other(format!("no answer within {seconds} s")));
        }
        std::thread::sleep(ANSWER_INTERVAL);
    };
    Ok(Output {
        status,
        stdout: stdout.join().unwrap_or_default(),
        stderr: stderr.join().unwrap_or_default(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str) -> Vec<String> {
        ["sh", "-c", script].map(str::to_owned).to_vec()
    }

    #[test]
    fn lines_of_the_queue_are_read_and_others_are_none() {
        let commands = Commands {
            list: shell(
                "printf '12|marf-ab|PENDING|Resources\\n 13_4 |other job|RUNNING|None\\n\\nslurm_load_jobs error\\n'",
            ),
            ..Commands::default()
        };
        let jobs = commands.list().unwrap();
        assert_eq!(jobs.len(), 2);
        let of = |name: &str| {
            let job = &jobs[name][0];
            (job.id.as_str(), job.state.as_str(), job.reason.as_str())
        };
        assert_eq!(of("marf-ab"), ("12", "pending", "Resources"));
        assert_eq!(of("other job"), ("13_4", "running", ""));
    }

    #[test]
    fn tasks_of_arrays_are_read_and_what_is_cut_stands_for_all() {
        for (id, array, tasks, number) in [
            ("12_4", "12", vec![4..=4], 1),
            ("12_[0-3,7%5]", "12", vec![0..=3, 7..=7], 5),
            ("12_[9]", "12", vec![9..=9], 1),
            ("12_[0-3,...]", "12", ALL.to_vec(), 1),
            ("12", "12", ALL.to_vec(), 1),
        ] {
            assert_eq!(tasks_of(id), (array, tasks.clone()), "{id}");
            assert_eq!(count(&tasks), number, "{id}");
        }
    }

    #[test]
    fn what_a_command_says_against_a_job_comes_through() {
        let commands = |submit: &str| Commands {
            submit: shell(submit),
            ..Commands::default()
        };
        assert_eq!(commands("echo '77;main'").submit("x").unwrap(), "77");
        let rejected =
            commands("echo 'sbatch: error: Invalid generic resource (gres) specification' >&2; exit 1");
        assert!(
            rejected
                .submit("x")
                .unwrap_err()
                .contains("Invalid generic resource")
        );
        assert!(
            commands("true")
                .submit("x")
                .unwrap_err()
                .contains("printed no id")
        );
        let absent = Commands {
            cancel: vec!["no-such-program-of-a-batch-system".to_owned()],
            ..Commands::default()
        };
        assert!(absent.cancel("1").unwrap_err().contains("there is no program"));
    }

    #[test]
    fn placeholders_are_filled_and_a_long_answer_comes_whole() {
        let commands = Commands {
            explain: shell("yes 'job {id}' | head -20000"),
            ..Commands::default()
        };
        let said = commands.explain("9");
        assert_eq!(said.lines().count(), 20_000);
        assert!(said.starts_with("job 9\n"));
    }
}
