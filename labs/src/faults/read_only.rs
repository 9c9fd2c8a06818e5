//! A store that may not be written: by its permissions, or on a file system that is mounted read-only.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::os::unix::fs::MetadataExt as _;
use std::path::PathBuf;
use std::process::Command;

use marf_cache::Digest;

use super::case::{Case, Variant, ends_in_one_error, files_of, is_success};
use super::injector::{Injector, Outcome, RoundError};
use super::lab::Lab;
use super::namespace::Namespace;

/// Verbs that only read.
const READERS: [&[&str]; 6] = [
    &["status"],
    &["log"],
    &["plan"],
    &["why", "blur", "--files"],
    &["cache", "stat"],
    &["cache", "fsck", "--read-data"],
];

/// Takes the right to write from copies of the undisturbed store.
pub struct ReadOnly<'a> {
    lab: &'a Lab,
    case: Case,
    /// Of the rounds with a mount.
    mount: Option<Namespace>,
    /// Digests of all files before.
    before: BTreeMap<PathBuf, Digest>,
}

impl<'a> ReadOnly<'a> {
    /// Makes nothing yet.
    pub fn new(lab: &'a Lab, case: Case) -> Self {
        Self {
            lab,
            case,
            mount: None,
            before: BTreeMap::new(),
        }
    }

    /// Gives the right to write back.
    fn lift(&mut self) -> Outcome {
        self.mount = None;
        self.case.wrapper.clear();
        if !self.case.store().exists() {
            return Ok(());
        }
        self.permissions("u+w")
    }

    fn permissions(&self, mode: &str) -> Outcome {
        let mut chmod = Command::new("chmod");
        let chmod = chmod.args(["-R", mode]).arg(self.case.store());
        is_success("chmod", &chmod.output()?)
    }

    /// Returns the digests of all files of the store.
    fn digests(&self) -> Outcome<BTreeMap<PathBuf, Digest>> {
        let store = self.case.store();
        let digest = |file: PathBuf| {
            let bytes = std::fs::read(store.join(&file))?;
            Ok((file, Digest::from_content(&bytes)))
        };
        files_of(&store).into_iter().map(digest).collect()
    }
}

impl Injector for ReadOnly<'_> {
    fn prepare(&mut self, round: u32) -> Outcome {
        self.lift()?;
        self.lab.reset_to_undisturbed(&self.case)?;
        self.before = self.digests()?;
        if round.is_multiple_of(2) {
            self.permissions("a-w")?;
            self.case.wrapper = without_privileges()?;
            return Ok(());
        }
        let mount = "mount --bind \"$1\" \"$1\"; mount -o remount,bind,ro \"$1\"";
        let namespace = Namespace::new(mount, &[self.case.store().as_os_str()])?;
        self.case.wrapper = namespace.wrapper();
        self.mount = Some(namespace);
        Ok(())
    }

    fn inject(&mut self, _round: u32) -> Outcome {
        for words in READERS {
            is_success(&words.join(" "), &self.case.command(words).output()?)?;
        }
        self.case.ends(Variant::Plain)?;
        let output = self.case.run_command(Variant::Changed).output()?;
        if !ends_in_one_error(&output, "--store")? {
            return Err(RoundError::Bad("a run stored what it may not".to_owned()));
        }
        Ok(())
    }

    fn judge(&mut self, _round: u32) -> Outcome {
        self.lift()?;
        if self.digests()? != self.before {
            return Err(RoundError::Bad("files of the store changed".to_owned()));
        }
        self.lab.ends_equal(&self.case, Variant::Changed)?;
        self.lab.is_whole(&self.case)
    }

    fn finish(&mut self) -> Outcome {
        self.lift()
    }

    fn detail(&self) -> String {
        "by permissions and by a read-only mount: readers and a run without work end well, a run with work in one error, and \
         no file changes"
            .to_owned()
    }
}

/// Returns the words to put before a command so that permissions hold for it: for root, a command that drops all
/// capabilities.
fn without_privileges() -> Outcome<Vec<OsString>> {
    let is_root = std::fs::metadata("/proc/self")?.uid() == 0;
    let setpriv = "setpriv --bounding-set=-all --inh-caps=-all --ambient-caps=-all --";
    let words = setpriv.split(' ').filter(|_| is_root);
    Ok(words.map(OsString::from).collect())
}
