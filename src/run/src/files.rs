//! Reading files that users name, and writing files atomically.

use std::path::{Path, PathBuf};

use marf_cache::file::{FileKind, Links, read_unless};
use marf_engine::Cancel;

use crate::error::{Diagnostic, Error};

/// Reads a result, a photo or another file that the user names.
///
/// # Errors
/// The wish to stop. Otherwise `refuse` of the cause: a file that is absent, not a regular file, or too large.
pub fn read_named(
    path: &Path,
    cancel: &Cancel,
    refuse: impl FnOnce(std::io::Error) -> Error,
) -> Result<Vec<u8>, Error> {
    let read = read_unless(path, FileKind::Result.max_bytes(), Links::Followed, || {
        cancel.is_set()
    });
    read.map_err(|error| {
        if cancel.is_set() {
            Error::Interrupted
        } else {
            refuse(error)
        }
    })
}

/// Writes a file through a temporary file next to it, so that a reader never sees half of it.
///
/// # Errors
/// A folder that cannot be created or written. The error has the path and the message of the system.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let refuse = |error: std::io::Error| {
        Error::Failed(Diagnostic {
            message: format!("cannot write {}", path.display()),
            cause: Some(error.to_string()),
            hint: Some("free space there or choose another place with --out".to_owned()),
        })
    };
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder {
        std::fs::create_dir_all(folder).map_err(refuse)?;
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let partial = path.with_file_name(format!(".{name}.{}.part", std::process::id()));
    std::fs::write(&partial, bytes)
        .and_then(|()| std::fs::rename(&partial, path))
        .map_err(|error| {
            let _ = std::fs::remove_file(&partial); // it may not exist; the first error is returned
            refuse(error)
        })
}

/// Removes a file. A file that does not exist is not an error.
///
/// # Errors
/// A file that cannot be removed.
pub fn remove(path: &Path) -> Result<(), Error> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(Error::Failed(Diagnostic::new(
            format!("cannot remove {}: {error}", path.display()),
        ))),
        _ => Ok(()),
    }
}

/// Returns the relative path from one folder to another, with `/` and `..`: `.` if they are the same. The first need not exist.
///
/// # Errors
/// A path with names that are not UTF-8.
pub fn relative(from: &Path, to: &Path) -> Result<String, Error> {
    let (from, to) = (settled(from), settled(to));
    let shared = from
        .components()
        .zip(to.components())
        .take_while(|(a, b)| a == b)
        .count();
    let up = from.components().skip(shared).map(|_| Some(".."));
    let down = to.components().skip(shared).map(|part| part.as_os_str().to_str());
    let parts: Option<Vec<&str>> = up.chain(down).collect();
    let Some(parts) = parts else {
        return Err(Error::usage(format!(
            "{}: the name is not UTF-8, which a JSON file needs",
            to.display()
        )));
    };
    Ok(if parts.is_empty() {
        ".".to_owned()
    } else {
        parts.join("/")
    })
}

/// Returns a path without links and `..`, as far as it exists.
fn settled(path: &Path) -> PathBuf {
    let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    match (whole.canonicalize(), whole.parent(), whole.file_name()) {
        (Ok(settled), ..) => settled,
        (Err(_), Some(parent), Some(name)) => settled(parent).join(name),
        _ => whole,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_appears_whole_in_a_folder_that_did_not_exist() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a/b.txt");
        write(&path, b"x").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"x");
        assert_eq!(std::fs::read_dir(dir.path().join("a")).unwrap().count(), 1);
    }

    #[test]
    fn the_way_between_folders_is_told_with_dots_and_slashes() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::create_dir_all(at("photos/raw")).unwrap();
        for (from, to, way) in [
            ("photos", "photos/raw", "raw"),
            ("out/new", "photos", "../../photos"),
            ("photos/raw", "photos", ".."),
            ("photos", "photos/raw/..", "."),
        ] {
            assert_eq!(relative(&at(from), &at(to)).unwrap(), way, "{from} {to}");
        }
    }
}
