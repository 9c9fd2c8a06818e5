//! Preparation of a store before use: its folders, its form, and the files of dead processes.

use std::path::Path;

use super::{
    StoreError,
    files::{Access, Files},
    format, lease,
    locks::{Lock, Locks, Share},
    notices::Notices,
    staging,
};

/// Returns whether the store in a folder can be written. An absent folder counts as writable.
pub(super) fn access_of(dir: &Path) -> Access {
    let Ok(meta) = std::fs::metadata(dir) else {
        return Access::ReadWrite;
    };
    if meta.permissions().readonly() {
        return Access::ReadOnly;
    }
    match Locks::new(dir).try_take(Lock::Index, Share::Shared) {
        Err(StoreError::Io { source, .. })
            if matches!(
                source.kind(),
                std::io::ErrorKind::PermissionDenied | std::io::ErrorKind::ReadOnlyFilesystem
            ) =>
        {
            Access::ReadOnly
        }
        _ => Access::ReadWrite,
    }
}

/// Creates what a store lacks and removes what dead processes left.
pub(super) fn prepare(
    dir: &Path,
    files: &Files,
    found: format::StoreForm,
    notices: &Notices,
) -> Result<(), StoreError> {
    for part in ["cas", "packs", "runs", "tmp"] {
        let path = dir.join(part);
        if !path.is_dir() {
            files.create_dir(&path)?;
        }
    }
    if found != format::StoreForm::Current {
        write_format(dir, files, notices)?;
    }
    staging::sweep(files, &dir.join("tmp"));
    lease::sweep(dir, files);
    Ok(())
}

/// Writes the file `format`, and quarantines a damaged one. One that another program has written meanwhile
/// stays.
pub(super) fn write_format(dir: &Path, files: &Files, notices: &Notices) -> Result<(), StoreError> {
    let _alone = Locks::new(dir).take(Lock::Format, Share::Exclusive, notices)?;
    if format::find(files, dir)? == format::StoreForm::Current {
        return Ok(());
    }
    let path = dir.join("format");
    if path.exists() {
        let to = files.quarantine(dir, &path, "format")?;
        notices.warn(format!(
            "the file `format` of the store was damaged and moved to `{}`",
            to.display()
        ));
    }
    let staging = staging::StagingDir::create(files, &dir.join("tmp"), notices)?;
    let fresh = staging.next_path();
    files.write_new(&fresh, format::text().as_bytes())?;
    files.sync_files(std::slice::from_ref(&fresh))?;
    files.publish(&fresh, &path)?;
    files.sync_dirs(&[dir.to_owned()])?;
    // The folder of the store may be new too.
    match dir.parent().filter(|parent| parent.is_dir()) {
        Some(parent) => files.sync_dirs(&[parent.to_owned()]),
        None => Ok(()),
    }
}
