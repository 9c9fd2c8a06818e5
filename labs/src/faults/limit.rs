//! Files that may not grow beyond a limit (RLIMIT_FSIZE), until the limit is lifted.

use std::process::{Command, Stdio};

use super::case::{Case, Variant, ends_in_one_error};
use super::injector::{Fault, Injector, Outcome};
use super::lab::Lab;

/// Largest limit, in blocks of 512 bytes.
const MOST_BLOCKS: u64 = 400;

/// Limits runs of new stores.
pub struct Limit<'a> {
    pub lab: &'a Lab,
    pub case: Case,
    /// Runs that met the limit.
    pub failed: u32,
}

impl Injector for Limit<'_> {
    fn prepare(&mut self, _round: u32) -> Outcome {
        self.lab.reset(&self.case)
    }

    fn inject(&mut self, round: u32) -> Outcome {
        let blocks = 1 + self.lab.random(Fault::Limit, round) % MOST_BLOCKS;
        let run = self.case.run_command(Variant::Plain);
        let script = "ulimit -f \"$1\"; shift; exec \"$@\"";
        let mut limited = Command::new("sh");
        limited.args(["-c", script, "sh", &blocks.to_string()]);
        limited.arg(run.get_program()).args(run.get_args());
        let output = limited.stdin(Stdio::null()).output()?;
        self.failed += u32::from(ends_in_one_error(&output, "File too large")?);
        Ok(())
    }

    fn judge(&mut self, _round: u32) -> Outcome {
        self.lab.ends_equal(&self.case, Variant::Plain)
    }

    fn detail(&self) -> String {
        format!(
            "files limited to 1 to {MOST_BLOCKS} blocks of 512 bytes, which {} runs met, then without a limit",
            self.failed
        )
    }
}
