//! A mount namespace of its own, in which an ordinary user may mount.

use std::ffi::{OsStr, OsString};
use std::fmt::Display;
use std::io::{BufRead as _, BufReader, Read as _};
use std::process::{Child, Command, Stdio};

use marf_run::{Diagnostic, Error};

/// A user and mount namespace. It ends when this is dropped.
pub struct Namespace {
    /// Waits in the namespace until its input ends.
    holder: Child,
}

impl Namespace {
    /// Makes a namespace and mounts in it, by a script of the shell and its arguments.
    ///
    /// # Errors
    /// A system on which this user may not mount, or that has no `unshare` or `nsenter`, with the way out.
    pub fn new(mount: &str, arguments: &[&OsStr]) -> Result<Self, Error> {
        let script = format!("set -e; {mount}; echo mounted; exec cat");
        let holder = Command::new("unshare")
            .args(["--user", "--map-root-user", "--mount", "sh", "-c", &script, "sh"])
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn();
        let mut namespace = Self {
            holder: holder.map_err(impossible)?,
        };
        namespace.await_mount()?;
        Ok(namespace)
    }

    fn await_mount(&mut self) -> Result<(), Error> {
        let mut line = String::new();
        if let Some(stdout) = self.holder.stdout.take() {
            let read = BufReader::new(stdout).read_line(&mut line);
            read.map_err(impossible)?;
        }
        if line == "mounted\n" {
            return Ok(());
        }
        let mut words = String::new();
        if let Some(mut stderr) = self.holder.stderr.take() {
            // An error of this read is ignored: the mount has failed anyway.
            let _ = stderr.read_to_string(&mut words);
        }
        Err(impossible(words.trim()))
    }

    /// Returns the words to put before a command to run it in the namespace.
    pub fn wrapper(&self) -> Vec<OsString> {
        let target = self.holder.id();
        let words = format!("nsenter --target {target} --user --mount --preserve-credentials --");
        words.split(' ').map(OsString::from).collect()
    }
}

impl Drop for Namespace {
    fn drop(&mut self) {
        let _ = self.holder.kill();
        let _ = self.holder.wait();
    }
}

fn impossible(cause: impl Display) -> Error {
    Error::Failed(Diagnostic {
        message: "a file system cannot be mounted for this fault".to_owned(),
        cause: Some(cause.to_string()),
        hint: Some(
            "let users make namespaces (`sysctl user.max_user_namespaces`; needs `unshare` and `nsenter`), or name the other \
             faults with --fault"
                .to_owned(),
        ),
    })
}
