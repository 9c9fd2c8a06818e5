//! A disk of 16 MB that runs full in the middle of a run, until space is freed.

use std::path::PathBuf;
use std::process::Command;

use super::case::{Case, Variant, ends_in_one_error, is_success};
use super::injector::{Fault, Injector, Outcome, RoundError};
use super::lab::Lab;
use super::namespace::Namespace;
use crate::process::bytes_below;

/// Size of the disk.
const DISK_BYTES: u64 = 16 << 20;

/// Runs on a full disk.
pub struct Full<'a> {
    lab: &'a Lab,
    disk: Namespace,
    /// Where the disk is mounted.
    dir: PathBuf,
    /// A folder on the disk.
    case: Case,
    /// What an undisturbed run needs, in bytes.
    needed: u64,
    failed: u32,
}

impl<'a> Full<'a> {
    /// Mounts the disk on the folder of a case.
    ///
    /// # Errors
    /// A system on which that cannot be done.
    pub fn new(lab: &'a Lab, case: Case) -> Outcome<Self> {
        let dir = case.dir;
        std::fs::create_dir_all(&dir)?;
        let mount = format!("mount -t tmpfs -o size={DISK_BYTES} marf \"$1\"");
        let disk = Namespace::new(&mount, &[dir.as_os_str()])?;
        Ok(Self {
            lab,
            case: Case {
                dir: dir.join("case"),
                wrapper: disk.wrapper(),
                ..case
            },
            disk,
            dir,
            needed: bytes_below(&lab.undisturbed().dir),
            failed: 0,
        })
    }

    /// Runs a script of the shell in the folder of the disk.
    fn script(&self, script: &str, arguments: &[&str]) -> Outcome {
        let mut words = self.disk.wrapper().into_iter();
        let mut command = Command::new(words.next().unwrap_or_default());
        command
            .args(words)
            .args(["sh", "-c", &format!("set -e; cd \"$1\"; {script}"), "sh"]);
        command.arg(&self.dir).args(arguments);
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
        let output = self.case.run_command(Variant::Plain).output()?;
        self.failed += u32::from(ends_in_one_error(&output, "No space left on device")?);
        Ok(())
    }

    fn judge(&mut self, _round: u32) -> Outcome {
        self.script("rm other", &[])?;
        self.lab.ends_equal(&self.case, Variant::Plain)?;
        self.lab.is_whole(&self.case)
    }

    fn finish(&mut self) -> Outcome {
        match self.failed {
            0 => Err(RoundError::Bad("the disk was never full".to_owned())),
            _ => Ok(()),
        }
    }

    fn detail(&self) -> String {
        let (disk_mb, failed) = (DISK_BYTES >> 20, self.failed);
        format!("a tmpfs of {disk_mb} MB, full in {failed} runs, then with space")
    }
}
