//! The queue of the batch system, read once for many readers.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use marf_stage::Cancel;
use parking_lot::Mutex;

use crate::commands::{Commands, ListedJob};

/// What names of jobs of marf begin with.
pub(crate) const PREFIX: &str = "marf-";

/// The queue as it was last.
#[derive(Debug)]
pub(crate) struct Queue {
    interval: Duration,
    last: Mutex<LastAnswer>,
}

#[derive(Debug, Default)]
struct LastAnswer {
    /// When the batch system was last asked. Absent if never.
    asked: Option<Instant>,
    /// Its jobs by name, from its last answer, and when that came.
    answer: Option<(Instant, BTreeMap<String, ListedJob>)>,
    /// Why the last question has no answer.
    fault: Option<String>,
}

/// The state of a job in the queue.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum JobState {
    /// It waits or runs. Also holds the numbers of running and waiting jobs of marf.
    Listed(ListedJob, Census),
    /// It is not in an answer that came after it was asked for.
    Absent,
    /// The batch system does not answer, for this reason.
    Unknown(String),
}

/// How many jobs of marf the batch system has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Census {
    pub running: usize,
    pub waiting: usize,
}

impl Census {
    fn from_jobs(jobs: &BTreeMap<String, ListedJob>) -> Self {
        let own = jobs.iter().filter(|(name, _)| name.starts_with(PREFIX));
        let (running, waiting): (Vec<_>, Vec<_>) = own.partition(|(_, job)| job.is_running());
        Self {
            running: running.len(),
            waiting: waiting.len(),
        }
    }
}

impl Queue {
    pub(crate) fn new(interval: Duration) -> Self {
        Self {
            interval,
            last: Mutex::default(),
        }
    }

    /// Returns the state of a job now. An answer younger than the interval is used again.
    ///
    /// `since` is when the job was submitted: an earlier answer says nothing about it.
    pub(crate) fn look(&self, commands: &Commands, name: &str, since: Instant, cancel: &Cancel) -> JobState {
        let mut last = self.last.lock();
        if last.asked.is_none_or(|asked| asked.elapsed() >= self.interval) {
            let asked = Instant::now();
            last.asked = Some(asked);
            match commands.list(cancel) {
                Ok(jobs) => (last.answer, last.fault) = (Some((asked, jobs)), None),
                Err(fault) => last.fault = Some(fault),
            }
        }
        let fresh = last.answer.as_ref().filter(|(asked, _)| *asked >= since);
        match (&last.fault, fresh) {
            (Some(fault), _) => JobState::Unknown(fault.clone()),
            (None, None) => JobState::Unknown(String::new()),
            (None, Some((_, jobs))) => match jobs.get(name) {
                Some(job) => JobState::Listed(job.clone(), Census::from_jobs(jobs)),
                None => JobState::Absent,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(script: &str) -> Commands {
        Commands {
            list: ["sh", "-c", script].map(str::to_owned).to_vec(),
            ..Commands::default()
        }
    }

    #[test]
    fn many_looks_ask_once_and_an_older_answer_tells_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let count = dir.path().join("count");
        let commands = list(&format!(
            "echo x >> '{}'; echo '1|a|RUNNING|None'",
            count.display()
        ));
        let queue = Queue::new(Duration::from_secs(3600));
        let before = Instant::now();
        for _ in 0..50 {
            assert!(
                matches!(queue.look(&commands, "a", before, &Cancel::default()), JobState::Listed(job, _) if job.id == "1")
            );
        }
        assert_eq!(
            queue.look(&commands, "b", before, &Cancel::default()),
            JobState::Absent
        );
        assert_eq!(
            queue.look(&commands, "b", Instant::now(), &Cancel::default()),
            JobState::Unknown(String::new())
        );
        assert_eq!(std::fs::read_to_string(count).unwrap().lines().count(), 1);
    }

    #[test]
    fn jobs_of_marf_are_counted_and_others_are_not() {
        let lines = [
            "1|marf-a|RUNNING|None",
            "2|marf-b|PENDING|Priority",
            "3|marf-c|PENDING|Resources",
            "5|marf-d|PENDING|Resources",
            "6|marf-e|RUNNING|None",
            "4|tea|RUNNING|None",
        ];
        let queue = Queue::new(Duration::ZERO);
        let commands = list(&format!("printf '{}\\n'", lines.join("\\n")));
        let census = Census {
            running: 2,
            waiting: 3,
        };
        let state = queue.look(&commands, "marf-b", Instant::now(), &Cancel::default());
        assert!(matches!(state, JobState::Listed(job, found) if job.reason == "Priority" && found == census));
    }

    #[test]
    fn a_queue_that_does_not_answer_says_nothing_of_a_job() {
        let queue = Queue::new(Duration::ZERO);
        let now = Instant::now();
        assert_eq!(
            queue.look(&list("true"), "a", now, &Cancel::default()),
            JobState::Absent
        );
        let state = queue.look(&list("echo down >&2; exit 1"), "a", now, &Cancel::default());
        assert!(matches!(state, JobState::Unknown(why) if why.contains("down")));
        assert_eq!(
            queue.look(&list("true"), "a", now, &Cancel::default()),
            JobState::Absent
        );
    }
}
