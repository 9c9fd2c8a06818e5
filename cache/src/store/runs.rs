//! Run roots: numbered files, one a run, written after everything they name.

use std::{
    fs,
    path::{Path, PathBuf},
};

use super::{
    error::StoreError,
    files::{self, Published},
};

/// Gives a finished temporary file the next free number in the folder of runs, durably, and returns the number.
pub(super) fn publish(dir: &Path, file: &Path) -> Result<u64, StoreError> {
    let mut number = numbers(dir)?.last().copied().unwrap_or(0) + 1;
    // Two processes may want one number: the second takes the next.
    while files::link(file, &path_of(dir, number))? == Published::Present {
        number += 1;
    }
    let _ = fs::remove_file(file);
    files::sync(&[dir.to_owned()])?;
    Ok(number)
}

/// Returns the path of a run's file.
fn path_of(dir: &Path, number: u64) -> PathBuf {
    dir.join(format!("{number:06}.json"))
}

/// Returns the numbers of all runs, oldest first.
pub(super) fn numbers(dir: &Path) -> Result<Vec<u64>, StoreError> {
    let names = files::names(dir)?;
    let numbers = names
        .iter()
        .filter_map(|name| name.strip_suffix(".json")?.parse().ok());
    let mut numbers: Vec<u64> = numbers.collect();
    numbers.sort_unstable();
    Ok(numbers)
}

/// Reads a run's file.
pub(super) fn read(dir: &Path, number: u64) -> Result<Vec<u8>, StoreError> {
    let path = path_of(dir, number);
    fs::read(&path).map_err(StoreError::io("read", path))
}
