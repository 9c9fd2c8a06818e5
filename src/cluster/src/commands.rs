//! The commands of a batch system.

use std::{
    collections::BTreeMap,
    io,
    process::{Command, ExitStatus, Stdio},
    thread::JoinHandle,
    time::{Duration, Instant},
};

use marf_stage::{Cancel, format};
use serde::Deserialize;

/// Longest wait for an answer of the batch system.
const ANSWER_PATIENCE: Duration = Duration::from_secs(60);
/// Longest wait for it when the user wants to stop.
const STOP_PATIENCE: Duration = Duration::from_secs(1);
/// Most bytes of an answer: those of 300,000 jobs.
const MOST_ANSWER_BYTES: u64 = 32 << 20;
/// Most characters of a complaint that are shown.
const MOST_COMPLAINT: usize = 500;

/// Pause between two looks whether it has answered.
const ANSWER_INTERVAL: Duration = Duration::from_millis(10);

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
    pub(crate) fn submit(&self, script: &str, cancel: &Cancel) -> Result<String, String> {
        let printed = run(&self.submit, "{script}", script, cancel)?;
        // Slurm adds `;cluster` on sites with several.
        let id = printed.split([';', '\n']).next().unwrap_or_default().trim();
        if is_id(id) {
            Ok(id.to_owned())
        } else {
            let printed = format::cut(id, MOST_COMPLAINT);
            Err(format!(
                "`{}` printed no id of a job: {printed:?}",
                self.submit[0]
            ))
        }
    }

    /// Returns the jobs of the user by name, the first of each.
    pub(crate) fn list(&self, cancel: &Cancel) -> Result<BTreeMap<String, ListedJob>, String> {
        let printed = run(&self.list, "", "", cancel)?;
        let mut jobs = BTreeMap::new();
        for (name, job) in printed.lines().filter_map(listed) {
            jobs.entry(name).or_insert(job);
        }
        Ok(jobs)
    }

    /// Takes a job out of the queue.
    pub(crate) fn cancel(&self, id: &str) -> Result<(), String> {
        // The user wants to stop, and this is how.
        run(&self.cancel, "{id}", id, &Cancel::default()).map(drop)
    }

    /// Returns the explanation of the batch system for a job that is gone, or an empty text if it has
    /// forgotten the job.
    pub(crate) fn explain(&self, id: &str, cancel: &Cancel) -> String {
        run(&self.explain, "{id}", id, cancel).unwrap_or_default()
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

/// Runs a command, and returns what it printed.
fn run(command: &[String], placeholder: &str, value: &str, cancel: &Cancel) -> Result<String, String> {
    let filled = |word: &String| {
        if placeholder.is_empty() {
            word.clone()
        } else {
            word.replace(placeholder, value)
        }
    };
    let words: Vec<String> = command.iter().map(filled).collect();
    let answer = answer(&words, cancel).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => format!("there is no program `{}`", words[0]),
        _ => format!("`{}`: {error}", words[0]),
    })?;
    if answer.status.success() {
        Ok(answer.stdout)
    } else {
        let said = format::cut(answer.stderr.trim(), MOST_COMPLAINT);
        Err(format!("`{}` says: {said}", words[0]))
    }
}

/// What a command printed.
struct Answer {
    status: ExitStatus,
    stdout: String,
    stderr: String,
}

/// Runs a command to its end. A command that does not answer is stopped.
fn answer(words: &[String], cancel: &Cancel) -> io::Result<Answer> {
    let mut child = Command::new(&words[0])
        .args(&words[1..])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()?;
    let (stdout, stderr) = (printed(child.stdout.take()), printed(child.stderr.take()));
    let began = Instant::now();
    let mut until = began + ANSWER_PATIENCE;
    let status = loop {
        let ended = child.try_wait()?;
        let is_read = stdout.is_finished() && stderr.is_finished();
        if let (Some(status), true) = (ended, is_read) {
            break status;
        }
        if ended.is_some() || cancel.is_set() {
            until = until.min(Instant::now() + STOP_PATIENCE);
        }
        if Instant::now() >= until {
            if ended.is_some() {
                return Err(io::Error::other(
                    "it ended, and a program that it started keeps its output open",
                ));
            }
            child.kill()?;
            child.wait()?;
            let seconds = began.elapsed().as_secs();
            return Err(io::Error::other(format!(
                "timed out: no answer within {seconds} s"
            )));
        }
        std::thread::sleep(ANSWER_INTERVAL);
    };
    let text = |printed: JoinHandle<io::Result<String>>| printed.join().unwrap_or_else(|_| Ok(String::new()));
    Ok(Answer {
        status,
        stdout: text(stdout)?,
        stderr: text(stderr)?,
    })
}

/// Reads what a command prints while it runs: a long queue does not fit a pipe.
fn printed(pipe: Option<impl io::Read + Send + 'static>) -> JoinHandle<io::Result<String>> {
    std::thread::spawn(move || {
        let mut bytes = Vec::new();
        let read = pipe.map(|pipe| io::copy(&mut pipe.take(MOST_ANSWER_BYTES), &mut bytes));
        if read.transpose()? == Some(MOST_ANSWER_BYTES) {
            let most = format::size(MOST_ANSWER_BYTES);
            return Err(io::Error::other(format!("it printed {most} or more")));
        }
        Ok(String::from_utf8_lossy(&bytes).into_owned())
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
        let jobs = commands.list(&Cancel::default()).unwrap();
        assert_eq!(jobs.len(), 2);
        let of = |name: &str| {
            let job = &jobs[name];
            (job.id.as_str(), job.state.as_str(), job.reason.as_str())
        };
        assert_eq!(of("marf-ab"), ("12", "pending", "Resources"));
        assert_eq!(of("other job"), ("13_4", "running", ""));
    }

    #[test]
    fn what_a_command_says_against_a_job_comes_through() {
        let commands = |submit: &str| Commands {
            submit: shell(submit),
            ..Commands::default()
        };
        assert_eq!(
            commands("echo '77;main'")
                .submit("x", &Cancel::default())
                .unwrap(),
            "77"
        );
        let rejected =
            commands("echo 'sbatch: error: Invalid generic resource (gres) specification' >&2; exit 1");
        assert!(
            rejected
                .submit("x", &Cancel::default())
                .unwrap_err()
                .contains("Invalid generic resource")
        );
        assert!(
            commands("true")
                .submit("x", &Cancel::default())
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
        let said = commands.explain("9", &Cancel::default());
        assert_eq!(said.lines().count(), 20_000);
        assert!(said.starts_with("job 9\n"));
    }

    #[test]
    fn a_hostile_command_is_an_error_of_few_words() {
        let cancel = Cancel::default();
        let list = |script: &str| {
            let list = shell(script);
            Commands {
                list,
                ..Commands::default()
            }
            .list(&cancel)
            .unwrap_err()
        };
        assert!(list("yes '1|a|RUNNING|None'").contains("it printed 33.6 MB or more"));
        assert!(list("sleep 20 & echo '1|a|RUNNING|None'").contains("keeps its output open"));
        let said = list("yes complaint | head -c 5000000 >&2; exit 1");
        assert!(said.contains("says: complaint") && said.len() < 1_000, "{said}");
    }

    #[test]
    fn a_command_that_is_silent_ends_soon_when_the_user_wants_to_stop() {
        let silent = Commands {
            list: shell("exec sleep 50"),
            ..Commands::default()
        };
        let cancel = Cancel::default();
        cancel.set();
        let began = Instant::now();
        assert!(silent.list(&cancel).unwrap_err().contains("timed out"));
        assert!(began.elapsed() < Duration::from_secs(10), "{:?}", began.elapsed());
    }
}
