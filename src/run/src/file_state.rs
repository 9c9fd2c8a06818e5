//! Size and times of a file, which show whether it has changed.

use std::path::Path;
use std::time::UNIX_EPOCH;

use serde::{Deserialize, Serialize};

/// Size and times of a file. A file that was edited differs in one of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileState {
    bytes: u64,
    modified_ns: u128,
    inode: u64,
}

/// Returns size and times of a file or folder. None if it cannot be read.
pub fn state_of(path: &Path) -> Option<FileState> {
    let meta = std::fs::metadata(path).ok()?;
    let modified = meta.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
    #[cfg(unix)]
    let inode = std::os::unix::fs::MetadataExt::ino(&meta);
    #[cfg(not(unix))]
    let inode = 0;
    Some(FileState {
        bytes: meta.len(),
        modified_ns: modified.as_nanos(),
        inode,
    })
}
