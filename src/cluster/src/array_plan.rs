//! The submitted arrays and their progress.

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use marf_cache::Digest;
use serde::{Deserialize, Serialize};

use crate::queue::{ATTEMPTS, PREFIX};

/// Digits of the digest of its tasks in the name of an array.
const NAME_DIGITS: usize = 16;

/// The arrays that were submitted for a node, as stored in its file.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Plan {
    pub(crate) arrays: Vec<PlannedArray>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PlannedArray {
    pub(crate) name: String,
    pub(crate) memory_mb: u64,
    /// Keys of its tasks, in the order of their numbers.
    pub(crate) tasks: Vec<Digest>,
}

/// Some parts that one task computes, one after the other. Its key is the digest of their actions, a line each.
pub(crate) struct Task {
    pub(crate) key: Digest,
    pub(crate) parts: Vec<Digest>,
    /// Number of the array in which it was last submitted.
    pub(crate) array: usize,
    /// Its number there.
    pub(crate) index: usize,
    pub(crate) attempts_left: u32,
    /// An earlier run has submitted it, and the batch system was not seen to have it.
    pub(crate) is_adopted: bool,
    pub(crate) absent_since: Option<Instant>,
    pub(crate) is_done: bool,
}

/// A job of many tasks.
pub(crate) struct Array {
    pub(crate) planned: PlannedArray,
    /// Earlier answers of the batch system say nothing about it.
    pub(crate) since: Instant,
    /// Its id, once the batch system has reported it.
    pub(crate) id: Option<String>,
}

impl PlannedArray {
    pub(crate) fn new(tasks: Vec<Digest>, memory_mb: u64) -> Self {
        let joined: Vec<String> = tasks.iter().map(Digest::to_string).collect();
        let digest = Digest::from_content(joined.join("\n").as_bytes()).to_string();
        Self {
            name: format!("{PREFIX}{}", &digest[..NAME_DIGITS]),
            memory_mb,
            tasks,
        }
    }
}

impl Task {
    pub(crate) fn new(key: Digest, parts: Vec<Digest>) -> Self {
        Self {
            key,
            parts,
            array: 0,
            index: 0,
            attempts_left: ATTEMPTS,
            is_adopted: false,
            absent_since: None,
            is_done: false,
        }
    }
}

/// Returns the script of an array, and the list of its tasks.
pub(crate) fn array_files(folder: &Path, name: &str) -> [PathBuf; 2] {
    [
        folder.join(format!("{name}.sh")),
        folder.join(format!("{name}.tasks")),
    ]
}
