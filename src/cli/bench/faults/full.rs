//! A disk of 16 MB that runs full in the middle of a run, until space is freed.

use std::process::Command;

use super::super::child::bytes_below;
use super::args::Fault;
use super::case::{Case, ends_in_one_error, is_success};
use super::lab::{Lab, Variant};
use super::namespace::Namespace;
use super::{Injector, Outcome, RoundError};
use marf_run::Error;

/// Size of the disk.
const DISK_BYTES: u64 = 16 << 20;

/// Runs on a full disk.
pub struct Full<'a> {
    lab: &'a Lab,
    disk: Namespace,
    /// What an undisturbed run needs, in bytes.
    needed: u64,
    failed: u32,
}

impl<'a> Full<'a> {
    /// Mounts the disk.
    ///
    /// # Errors
    /// A system on which that cannot be done.
    pub fn new(lab: &'a Lab) -> Result<Self, Error> {
        let dir = lab.dir.join("disk");
        std::fs::create_dir_all(&dir).map_err(|error| Error::failed(error.to_string()))?;
        let mount = format!("mount -t tmpfs -o size={DISK_BYTES} marf \"$1\"");
        Ok(Self {
            disk: Namespace::new(&mount, &[dir.as_os_str()])?,
            needed: bytes_below(&lab.undisturbed().dir),
            lab,
            failed: 0,
        })
    }

    fn case(&self) -> Case<'_> {
        Case {
            wrapper: self.disk.wrapper(),
            ..Case::at(self.lab, self.lab.dir.join("disk/case"))
        }
    }

    /// Runs a script of the shell in the folder of the disk.
    fn script(&self, script: &str, arguments: &[&str]) -> Outcome {
        let mut words = self.disk.wrapper().into_iter();
        let mut command = Command::new(words.next().unwrap_or_default());
        command
            .args(words)
            .args(["sh", "-c", &format!("set -e; cd \"$1\"; {script}"), "sh"]);
        command.arg(self.lab.dir.join("disk")).args(arguments);
        is_success(script, &command.output()?)
    }
}

impl Injector for Full<'_> {
    fn prepare(&mut self, round: u32) -> Outcome {
        // The first disk is too small for certain, others have from no byte to more than is needed.
        let most = match round {
            0 => self.needed / 2,
            _ => self.needed * 3 / 2,
        };
        let free = self.lab.random(Fault::Full, round) % most.max(1);
        let other = DISK_BYTES.saturating_sub(free).to_string();
        // The last bytes of the other file may not fit any more.
        let fill = "rm -rf case other; mkdir case; printf %s \"$2\" > case/pipeline.toml; \
                    head -c \"$3\" /dev/zero > other 2>/dev/null || true";
        self.script(fill, &[self.lab.pipeline(), &other])
    }

    fn inject(&mut self, _round: u32) -> Outcome {
        let output = self.case().run_command(Variant::Plain).output()?;
        self.failed += u32::from(ends_in_one_error(&output, "No space left on device")?);
        Ok(())
    }

    fn judge(&mut self, _round: u32) -> Outcome {
        self.script("rm other", &[])?;
        let case = self.case();
        case.ends_equal(Variant::Plain)?;
        case.is_whole()
    }

    fn finish(&mut self) -> Outcome {
        match self.failed {
            0 => Err(RoundError::Bad("the disk was never full".to_owned())),
            _ => Ok(()),
        }
    }

    fn detail(&self) -> String {
        format!(
            "a tmpfs of {} MB, full in {} runs; then with space",
            DISK_BYTES >> 20,
            self.failed
        )
    }
}
