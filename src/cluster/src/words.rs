//! Texts about jobs.

use marf_stage::format;

/// Most characters of a word of the batch system.
const MOST_WORDS: usize = 200;

/// Returns the memory of a job.
pub(crate) fn memory(memory_mb: u64) -> String {
    format::size(memory_mb.saturating_mul(1_000_000))
}

/// Returns the state of a job in words: `job 12 pending (Resources)`.
pub(crate) fn note(id: &str, state: &str, reason: &str) -> String {
    if reason.is_empty() {
        format!("job {id} {state}")
    } else {
        format!("job {id} {state} ({})", format::cut(reason, MOST_WORDS))
    }
}

/// Returns the words `JobState=…` and `Reason=…` of what Slurm says of a job, or the first words of another batch system.
pub(crate) fn in_short(said: &str) -> String {
    let is_wanted = |word: &&str| {
        ["JobState=", "Reason=", "ExitCode="]
            .iter()
            .any(|key| word.starts_with(key))
    };
    let words: Vec<&str> = said.split_whitespace().filter(is_wanted).collect();
    if !words.is_empty() {
        return format::cut(&words.join(" "), MOST_WORDS);
    }
    let first = said.trim().lines().next();
    format::cut(first.unwrap_or("the batch system knows it no more"), MOST_WORDS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_slurm_says_of_a_job_is_put_in_short() {
        let said = "JobId=12 JobName=marf-ab UserId=root(0) JobState=OUT_OF_MEMORY Reason=OutOfMemory Requeue=1 ExitCode=0:125 Nice=0";
        assert_eq!(
            in_short(said),
            "JobState=OUT_OF_MEMORY Reason=OutOfMemory ExitCode=0:125"
        );
        assert_eq!(in_short(" \n"), "the batch system knows it no more");
        assert_eq!(
            in_short("job 7 has been deleted\nmore\n"),
            "job 7 has been deleted"
        );
        assert_eq!(note("7", "pending", "Priority"), "job 7 pending (Priority)");
        assert_eq!(note("7", "running", ""), "job 7 running");
        assert_eq!(memory(1_400), "1.4 GB");
        assert_eq!(in_short(&"x".repeat(9_000)).chars().count(), MOST_WORDS);
    }
}
