//! Writing files atomically.

use std::path::Path;

use super::error::{CliError, Diagnostic};

/// Writes a file through a temporary neighbour, so that a reader never sees half of it.
///
/// # Errors
/// A folder that cannot be made or written; the path and the system's word for it.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), CliError> {
    let refuse = |error: std::io::Error| {
        CliError::Failed(Diagnostic {
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

/// Removes a file; one that is not there is no error.
///
/// # Errors
/// A file that cannot be removed.
pub fn remove(path: &Path) -> Result<(), CliError> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(CliError::Failed(Diagnostic::new(
            format!("cannot remove {}: {error}", path.display()),
        ))),
        _ => Ok(()),
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
}
