//! Files that may not grow beyond a limit (RLIMIT_FSIZE), until the limit is lifted.

use std::process::{Command, Stdio};

use super::args::Fault;
use super::case::{Case, ends_in_one_error};
use super::lab::{Lab, Variant};
use super::{Injector, Outcome};

/// Largest limit, in blocks of 512 bytes.
const MOST_BLOCKS: u64 = 400;

/// Limits runs of new stores.
pub struct Limit<'a> {
    lab: &'a Lab,
    case: Case<'a>,
    failed: u32,
}

impl<'a> Limit<'a> {
    /// Makes nothing yet.
    pub fn new(lab: &'a Lab) -> Self {
        Self {
            lab,
            case: Case::at(lab, lab.dir.join("limit")),
            failed: 0,
        }
    }
}

impl Injector for Limit<'_> {
    fn prepare(&mut self, _round: u32) -> Outcome {
        self.case = self.lab.case("limit")?;
        Ok(())
    }

    fn inject(&mut self, round: u32) -> Outcome {
        let blocks = 1 + self.lab.random(Fault::Limit, round) % MOST_BLOCKS;
        let run = self.case.run_command(Variant::Plain);
        // The signal of the limit is ignored, so that the write fails.
        let script = "trap '' XFSZ; ulimit -f \"$1\"; shift; exec \"$@\"";
        let mut limited = Command::new("sh");
        limited.args(["-c", script, "sh", &blocks.to_string()]);
        limited.arg(run.get_program()).args(run.get_args());
        let output = limited.stdin(Stdio::null()).output()?;
        self.failed += u32::from(ends_in_one_error(&output, "File too large")?);
        Ok(())
    }

    fn judge(&mut self, _round: u32) -> Outcome {
        self.case.ends_equal(Variant::Plain)
    }

    fn detail(&self) -> String {
        format!(
            "files limited to 1 to {MOST_BLOCKS} blocks of 512 bytes, which {} runs met; then without a limit",
            self.failed
        )
    }
}
