//! Finding, reading and writing the files of marf.lock.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use marf_cache::Digest;
use marf_stage::{Ctx, LOCK_FILE, StageError};
use serde::Deserialize;

use super::old::{self, OldArchive};
use super::{BadLine, SolPins, merge, text};
use crate::files::{self, Batch, beside};
use crate::stat::FileState;

/// Largest file that is read: a sol of half a million products, or two million products of the file of 0.1.0.
const MAX_BYTES: u64 = 1 << 30;
/// Pause between two attempts to hold the lock.
const RETRY: Duration = Duration::from_millis(10);
/// What is added to the name of the file of 0.1.0 while the folder takes its place.
const ASIDE: &str = ".0.1.0";
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
    form: Form,
    /// What other things the pins of this archive were written for, where there are none for what is asked.
    pub other: Option<String>,
}

#[derive(Debug)]
enum Form {
    /// The folder of the archive, and the sols that have a file.
    Folder(PathBuf, BTreeSet<u32>),
    /// The file of 0.1.0.
    Old(BTreeMap<u32, SolPins>),
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

/// What was written.
#[derive(Debug)]
pub(crate) struct Written {
    /// The pins of the changed sols, with what other processes had written.
    pub pins: Vec<SolPins>,
    /// Told where the file of 0.1.0 was replaced.
    pub notice: Option<String>,
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
    /// An `archive.toml`, or a file of 0.1.0, that cannot be read.
    pub fn open(&self) -> Result<OpenLock, StageError> {
        if let Some(path) = self.old_file() {
            let archive = self.read_old(&path)?.remove(&self.archive).unwrap_or_default();
            let mine = archive.asked == self.asked;
            return Ok(OpenLock {
                other: (!mine && !archive.sols.is_empty()).then_some(archive.asked),
                form: Form::Old(if mine { archive.sols } else { BTreeMap::new() }),
            });
        }
        let (folder, other) = self.folder()?;
        let sols = sols_in(&folder).map_err(|error| unreadable(&folder, &error))?;
        let other = other.filter(|_| sols.is_empty());
        Ok(OpenLock {
            form: Form::Folder(folder, sols),
            other,
        })
    }

    /// Writes changed sols, each into its own file, and leaves those alone that are there already. A file of 0.1.0 is
    /// replaced by the folder first.
    ///
    /// # Errors
    /// A file that cannot be written, or was damaged since it was read; the wish to stop.
    pub fn write(&self, ctx: &Ctx<'_>, changes: Vec<Change>) -> Result<Written, StageError> {
        let (held, notice) = self.hold(ctx)?;
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
        Ok(Written {
            pins: written,
            notice,
        })
    }

    /// Returns the file of a sol.
    ///
    /// # Errors
    /// An `archive.toml` that cannot be read.
    pub fn file(&self, sol: u32) -> Result<PathBuf, StageError> {
        Ok(sol_path(&self.folder()?.0, sol))
    }

    /// Returns the folder of the archive, and what it was written for where that is something else and there is no other.
    fn folder(&self) -> Result<(PathBuf, Option<String>), StageError> {
        let folder = self.path.join(folder_name(&self.archive));
        let Some(text) = read_text(&folder.join("archive.toml"))? else {
            return Ok((folder, None));
        };
        let found: Result<ArchiveFile, BadLine> = text::check(&text, text::VERSION)
            .and_then(|()| toml::from_str(&text).map_err(|error| text::bad(&text, &error)));
        let asked = found
            .map_err(|bad| damaged(&folder.join("archive.toml"), &bad, WHOLE))?
            .asked;
        if asked == self.asked {
            return Ok((folder, None));
        }
        let mark = Digest::of(self.asked.as_bytes()).short();
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

    /// Returns the file of 0.1.0 where there is no folder yet: at its place, or set aside by a process that died before the
    /// folder took its place.
    fn old_file(&self) -> Option<PathBuf> {
        match fs::metadata(&self.path) {
            Ok(meta) => meta.is_file().then(|| self.path.clone()),
            Err(_) => Some(beside(&self.path, ASIDE)).filter(|path| path.is_file()),
        }
    }

    fn read_old(&self, path: &Path) -> Result<BTreeMap<String, OldArchive>, StageError> {
        let text = read_text(path)?.unwrap_or_default();
        old::read(&text).map_err(|bad| damaged(path, &bad, WHOLE))
    }

    /// Waits until no other process writes; afterwards the folder is there.
    fn hold(&self, ctx: &Ctx<'_>) -> Result<(File, Option<String>), StageError> {
        let fail = |error: io::Error| unwritable(&self.path, &error);
        let mut notice = None;
        loop {
            if let Some(path) = self.old_file() {
                let file = OpenOptions::new()
                    .read(true)
                    .append(true)
                    .open(&path)
                    .map_err(fail)?;
                wait(ctx, &file, &path)?;
                // Another process may have replaced it meanwhile.
                if self.old_file().as_ref() == Some(&path) {
                    notice = Some(self.replace_old(&path)?);
                }
                continue;
            }
            match fs::create_dir(&self.path) {
                Err(error) if error.kind() != ErrorKind::AlreadyExists => return Err(fail(error)),
                _ => {}
            }
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
            // Left by a process that died when the folder was in place.
            match fs::remove_file(beside(&self.path, ASIDE)) {
                Err(error) if error.kind() != ErrorKind::NotFound => return Err(fail(error)),
                _ => return Ok((file, notice)),
            }
        }
    }

    /// Replaces the file of 0.1.0 by the folder. Whenever it is stopped, one of both is there whole.
    fn replace_old(&self, path: &Path) -> Result<String, StageError> {
        let archives = self.read_old(path)?;
        let fail = |error: io::Error| unwritable(&self.path, &error);
        let new = files::unfinished_path(&self.path);
        fs::create_dir(&new).map_err(fail)?;
        let outcome = write_archives(&new, archives).and_then(|products| {
            let aside = beside(&self.path, ASIDE);
            if path != aside {
                fs::rename(path, &aside)?;
            }
            fs::rename(&new, &self.path)?;
            fs::remove_file(aside)?;
            self.path
                .parent()
                .filter(|folder| !folder.as_os_str().is_empty())
                .map_or(Ok(()), files::sync_folder)?;
            Ok(products)
        });
        match outcome {
            Ok(products) => Ok(format!(
                "`{}` was a file of marf 0.1.0 and is a folder now, with a file a sol: {products} products, none changed; \
                 commit the folder in place of the file",
                self.path.display()
            )),
            Err(error) => {
                drop(fs::remove_dir_all(&new));
                Err(fail(error))
            }
        }
    }
}

impl OpenLock {
    /// Returns the sols that have pins.
    pub fn sols(&self) -> BTreeSet<u32> {
        match &self.form {
            Form::Folder(_, sols) => sols.clone(),
            Form::Old(sols) => sols.keys().copied().collect(),
        }
    }

    /// Returns the state of the file of a sol, if it has one.
    pub fn state(&self, sol: u32) -> Option<FileState> {
        match &self.form {
            Form::Folder(folder, sols) if sols.contains(&sol) => fs::metadata(sol_path(folder, sol))
                .ok()
                .map(|meta| FileState::from_metadata(&meta)),
            _ => None,
        }
    }

    /// Reads the pins of a sol, if it has any.
    ///
    /// # Errors
    /// A file that cannot be read, with the line.
    pub fn pins(&self, sol: u32) -> Result<Option<SolPins>, StageError> {
        match &self.form {
            // Also one that was written since.
            Form::Folder(folder, _) => read_sol(&sol_path(folder, sol), sol),
            Form::Old(sols) => Ok(sols.get(&sol).cloned()),
        }
    }
}

fn write_archives(folder: &Path, archives: BTreeMap<String, OldArchive>) -> io::Result<usize> {
    let mut batch = Batch::default();
    batch.add(&folder.join(README), README_TEXT.as_bytes())?;
    let mut products = 0;
    for (name, archive) in archives {
        let lock = Lock {
            path: folder.to_owned(),
            archive: name,
            asked: archive.asked,
        };
        let folder = folder.join(folder_name(&lock.archive));
        fs::create_dir(&folder)?;
        batch.add(&folder.join("archive.toml"), lock.archive_text().as_bytes())?;
        for (sol, pins) in archive.sols {
            products += pins.files.len() + pins.left_out.len() + pins.gone.len();
            let text = text::write(&lock.archive, sol, &pins);
            batch.add(&sol_path(&folder, sol), text.as_bytes())?;
        }
    }
    batch.finish()?;
    Ok(products)
}

/// Waits for the lock on a file; it ends with the file.
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

/// Returns the name of an archive as a folder: what is no lower-case letter, digit, `-` or `_` is a `%` with its code, so that
/// no two archives share a folder on any file system.
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
    let text = match fs::metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Ok(meta) if meta.len() > MAX_BYTES => Err(io::Error::other(format!("it has {} bytes", meta.len()))),
        Ok(_) => fs::read(path).and_then(in_utf8),
        Err(error) => Err(error),
    };
    text.map(Some)
        .map_err(|error| unreadable(path, &error).hint(WHOLE))
}

fn in_utf8(bytes: Vec<u8>) -> io::Result<String> {
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
