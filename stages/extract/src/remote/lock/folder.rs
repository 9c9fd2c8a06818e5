//! Finding, reading and writing the files of marf.lock.

use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use marf_cache::Digest;
use marf_cache::file::{Links, read_within};
use marf_stage::{Ctx, LOCK_FILE, StageError};
use serde::Deserialize;

use super::{BadLine, SolPins, merge, text};
use crate::files::{self, Batch};
use crate::stat::FileState;

/// Largest file that is read: a sol of two million products.
pub(super) const MAX_BYTES: u64 = 1 << 30;
/// Pause between two attempts to hold the lock.
const RETRY: Duration = Duration::from_millis(10);
/// The file that writers hold a lock on.
const README: &str = "README";
const README_TEXT: &str = "\
This folder pins what each archive on a server gave, to the byte: a folder an archive, a file a sol, a line a product.
`marf run` writes it, `marf run --locked` takes exactly what it names. Keep it under version control.

To fetch a product anew, delete its line. A file that is lost is written again from the store, where an earlier run kept
it. A folder NAME@... is of another pipeline that calls its archive NAME too and asks it for something else; delete it when
no pipeline does so any more.
";

/// Where the pins of one archive lie.
#[derive(Debug, Clone)]
pub(crate) struct Lock {
    /// Path of marf.lock.
    pub path: PathBuf,
    /// Name of the `[archive.*]` table.
    pub archive: String,
    /// What the pipeline asks the archive for: kind, mission, camera and the like.
    pub asked: String,
}

/// The pins of an archive as they are found.
#[derive(Debug)]
pub(crate) struct OpenLock {
    /// The folder of the archive.
    folder: PathBuf,
    /// The sols that have a file.
    sols: BTreeSet<u32>,
    /// The request that the existing pins of this archive were written for, if there are none for the current
    /// request.
    pub other: Option<String>,
}

/// A sol whose pins changed.
#[derive(Debug)]
pub(crate) struct Change {
    /// The sol.
    pub sol: u32,
    /// The pins that were read.
    pub base: SolPins,
    /// The pins that are to be written.
    pub pins: SolPins,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ArchiveFile {
    #[serde(rename = "version")]
    _version: i64,
    asked: String,
}

impl Lock {
    /// Finds the pins of the archive. Those of a sol are read when they are asked for.
    ///
    /// # Errors
    /// An `archive.toml` that cannot be read.
    pub fn open(&self) -> Result<OpenLock, StageError> {
        let (folder, other) = self.folder()?;
        let sols = sols_in(&folder).map_err(|error| unreadable(&folder, &error))?;
        let other = other.filter(|_| sols.is_empty());
        Ok(OpenLock { folder, sols, other })
    }

    /// Writes changed sols, each into its own file, and leaves those alone that are there already. Returns the pins of these
    /// sols, with what other processes had written.
    ///
    /// # Errors
    /// A file that cannot be written, or was damaged since it was read. A requested stop.
    pub fn write(&self, ctx: &Ctx<'_>, changes: Vec<Change>) -> Result<Vec<SolPins>, StageError> {
        let held = self.hold(ctx)?;
        let (folder, _) = self.folder()?;
        let fail = |error: io::Error| unwritable(&folder, &error);
        fs::create_dir_all(&folder)
            .and_then(|()| files::remove_unfinished(&folder))
            .map_err(fail)?;
        let mut batch = Batch::default();
        let archive = folder.join("archive.toml");
        if !archive.exists() {
            batch
                .add(&archive, self.archive_text().as_bytes())
                .map_err(fail)?;
        }
        let mut written = Vec::new();
        for change in changes {
            let path = sol_path(&folder, change.sol);
            let theirs = read_sol(&path, change.sol)?;
            let known = theirs.as_ref().unwrap_or(&change.base);
            let merged = merge::merge(&change.base, &change.pins, known);
            if theirs.as_ref() != Some(&merged) {
                let text = text::write(&self.archive, change.sol, &merged);
                batch.add(&path, text.as_bytes()).map_err(fail)?;
            }
            written.push(merged);
        }
        batch.finish().map_err(fail)?;
        drop(held);
        Ok(written)
    }

    /// Returns the file of a sol.
    ///
    /// # Errors
    /// An `archive.toml` that cannot be read.
    pub fn file(&self, sol: u32) -> Result<PathBuf, StageError> {
        Ok(sol_path(&self.folder()?.0, sol))
    }

    /// Returns the folder of the archive. If the plain folder was written for another request, returns a folder of
    /// its own, and that request.
    fn folder(&self) -> Result<(PathBuf, Option<String>), StageError> {
        let folder = self.path.join(folder_name(&self.archive));
        let Some(text) = read_text(&folder.join("archive.toml"))? else {
            return Ok((folder, None));
        };
        let found: Result<ArchiveFile, BadLine> =
            text::check(&text).and_then(|()| toml::from_str(&text).map_err(|error| text::bad(&text, &error)));
        let asked = found
            .map_err(|bad| damaged(&folder.join("archive.toml"), &bad, WHOLE))?
            .asked;
        if asked == self.asked {
            return Ok((folder, None));
        }
        let mark = Digest::from_content(self.asked.as_bytes()).short();
        let own = self.path.join(format!("{}@{mark}", folder_name(&self.archive)));
        Ok((own, Some(asked)))
    }

    fn archive_text(&self) -> String {
        format!(
            "# Archive {}. Written by `marf run`; see the README.\nversion = {}\nasked = {}\n",
            text::quoted(&self.archive),
            text::VERSION,
            text::quoted(&self.asked)
        )
    }

    /// Waits until no other process writes. Afterwards the folder exists.
    fn hold(&self, ctx: &Ctx<'_>) -> Result<File, StageError> {
        let fail = |error: io::Error| unwritable(&self.path, &error);
        fs::create_dir_all(&self.path).map_err(fail)?;
        let path = self.path.join(README);
        let mut file = OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path)
            .map_err(fail)?;
        wait(ctx, &file, &path)?;
        if file.metadata().map_err(fail)?.len() == 0 {
            file.write_all(README_TEXT.as_bytes()).map_err(fail)?;
        }
        Ok(file)
    }
}

impl OpenLock {
    /// Returns the sols that have pins.
    pub fn sols(&self) -> &BTreeSet<u32> {
        &self.sols
    }

    /// Returns the state of the file of a sol, if it has one.
    pub fn state(&self, sol: u32) -> Option<FileState> {
        let path = self.sols.contains(&sol).then(|| sol_path(&self.folder, sol))?;
        fs::metadata(path)
            .ok()
            .map(|meta| FileState::from_metadata(&meta))
    }

    /// Reads the current pins of a sol, if it has any, including those written since.
    ///
    /// # Errors
    /// A file that cannot be read, with the line.
    pub fn pins(&self, sol: u32) -> Result<Option<SolPins>, StageError> {
        read_sol(&sol_path(&self.folder, sol), sol)
    }
}

/// Waits for the lock on a file, which ends with the file.
fn wait(ctx: &Ctx<'_>, file: &File, path: &Path) -> Result<(), StageError> {
    loop {
        match file.try_lock() {
            Ok(()) => return Ok(()),
            Err(TryLockError::WouldBlock) => {
                ctx.check()?;
                std::thread::sleep(RETRY);
            }
            Err(TryLockError::Error(error)) => {
                return Err(unwritable(path, &error).hint("the file system must be able to lock files"));
            }
        }
    }
}

/// Returns the sols that have a file in the folder of an archive.
fn sols_in(folder: &Path) -> io::Result<BTreeSet<u32>> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(BTreeSet::new()),
        entries => entries?,
    };
    let mut sols = BTreeSet::new();
    for entry in entries {
        let name = entry?.file_name();
        let sol = name
            .to_str()
            .and_then(|name| name.strip_prefix("sol-")?.strip_suffix(".toml")?.parse().ok());
        // `sol-1.toml` and `sol-00001.toml` would be one sol.
        sols.extend(sol.filter(|sol| name == sol_path(Path::new(""), *sol)));
    }
    Ok(sols)
}

fn sol_path(folder: &Path, sol: u32) -> PathBuf {
    folder.join(format!("sol-{sol:05}.toml"))
}

/// Returns the name of an archive as a folder. A byte that is not a lower-case letter, digit, `-` or `_` becomes a
/// `%` with its code, so that no two archives share a folder on any file system.
fn folder_name(archive: &str) -> String {
    if archive.is_empty() {
        return "%".to_owned();
    }
    let plain = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-' || byte == b'_';
    archive
        .bytes()
        .map(|byte| {
            if plain(byte) {
                char::from(byte).to_string()
            } else {
                format!("%{byte:02X}")
            }
        })
        .collect()
}

fn read_sol(path: &Path, sol: u32) -> Result<Option<SolPins>, StageError> {
    let Some(text) = read_text(path)? else {
        return Ok(None);
    };
    text::read(&text, sol)
        .map(Some)
        .map_err(|bad| damaged(path, &bad, ONE_SOL))
}

fn read_text(path: &Path) -> Result<Option<String>, StageError> {
    match read_within(path, MAX_BYTES, Links::Followed).and_then(in_utf8) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(unreadable(path, &error).hint(WHOLE)),
        Ok(text) => Ok(Some(text)),
    }
}

pub(super) fn in_utf8(bytes: Vec<u8>) -> io::Result<String> {
    String::from_utf8(bytes).map_err(|error| {
        let good = error.utf8_error().valid_up_to();
        let line = error
            .as_bytes()
            .iter()
            .take(good)
            .filter(|byte| **byte == b'\n')
            .count()
            + 1;
        io::Error::other(format!("line {line} is not UTF-8"))
    })
}

const ONE_SOL: &str = "restore the file from version control, or delete it: it is then written anew from the store, or the products of \
                       this sol are fetched again";
const WHOLE: &str = "restore it from version control, or delete it: it is then written anew from the store, or everything it \
                     named is fetched again";

fn damaged(path: &Path, bad: &BadLine, hint: &str) -> StageError {
    StageError::new(format!("`{}`, line {}, cannot be read", path.display(), bad.line))
        .cause(bad.cause.clone())
        .hint(hint)
}

fn unreadable(path: &Path, error: &io::Error) -> StageError {
    StageError::new(format!("`{}` cannot be read", path.display())).cause(error.to_string())
}

fn unwritable(path: &Path, error: &io::Error) -> StageError {
    StageError::new(format!("`{}` cannot be written", path.display()))
        .cause(error.to_string())
        .hint(format!(
            "check the permissions of the folder that holds `{LOCK_FILE}`, and the space on its disk"
        ))
}
