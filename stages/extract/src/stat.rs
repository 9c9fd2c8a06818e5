//! What the file system says of a file: whether it can be another one than when it was last read.

use std::fs::Metadata;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

/// Time for which a file must not have changed before its state can identify its bytes, ns. The coarsest clocks of
/// file systems tick every 2 s. Within one tick a second change would not show.
const TICK_NS: i64 = 2_000_000_000;

/// The state of a file. While it is the same, the file was not written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct FileState {
    /// Length, bytes.
    pub size: u64,
    /// Last change of its bytes, ns since 1970.
    pub mtime_ns: i64,
    /// Last change of its entry, ns since 1970. No program can set it.
    pub ctime_ns: i64,
    /// Number of the file on its device.
    pub inode: u64,
    /// The device.
    pub device: u64,
}

impl FileState {
    /// Returns the state from the metadata of a file.
    #[cfg(unix)]
    pub fn from_metadata(meta: &Metadata) -> Self {
        use std::os::unix::fs::MetadataExt;
        let ns = |seconds: i64, nanos: i64| seconds.saturating_mul(1_000_000_000).saturating_add(nanos);
        Self {
            size: meta.len(),
            mtime_ns: ns(meta.mtime(), meta.mtime_nsec()),
            ctime_ns: ns(meta.ctime(), meta.ctime_nsec()),
            inode: meta.ino(),
            device: meta.dev(),
        }
    }

    /// Returns the state from the metadata of a file. Without inodes, a file of another creation time is another file.
    #[cfg(not(unix))]
    pub fn from_metadata(meta: &Metadata) -> Self {
        let ns = |time: std::io::Result<SystemTime>| time.map_or(i64::MAX, since_1970_ns);
        Self {
            size: meta.len(),
            mtime_ns: ns(meta.modified()),
            ctime_ns: ns(meta.created()),
            inode: 0,
            device: 0,
        }
    }

    /// Whether the file had rested for a tick of the coarsest clocks before `now_ns`. Otherwise it may be written
    /// again without a trace in its state, so bytes read at that time must not be cached by it.
    pub fn rested(&self, now_ns: i64) -> bool {
        self.mtime_ns.max(self.ctime_ns).saturating_add(TICK_NS) <= now_ns
    }
}

/// Returns the time, ns since 1970. It decides which files are read again but never enters a result.
pub(crate) fn now_ns() -> i64 {
    since_1970_ns(SystemTime::now())
}

fn since_1970_ns(time: SystemTime) -> i64 {
    let nanos = |time: std::time::Duration| i64::try_from(time.as_nanos()).unwrap_or(i64::MAX);
    time.duration_since(UNIX_EPOCH)
        .map_or_else(|before| -nanos(before.duration()), nanos)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(mtime_ns: i64, ctime_ns: i64) -> FileState {
        FileState {
            size: 1,
            mtime_ns,
            ctime_ns,
            inode: 1,
            device: 1,
        }
    }

    #[test]
    fn a_file_has_rested_when_both_its_times_are_a_tick_old() {
        assert!(state(0, 0).rested(TICK_NS));
        assert!(!state(0, 0).rested(TICK_NS - 1));
        assert!(
            !state(0, 1).rested(TICK_NS),
            "an old time of its bytes can be set by hand"
        );
        assert!(!state(i64::MAX, 0).rested(i64::MAX - 1), "a time to come");
        assert!(state(i64::MIN, i64::MIN).rested(0));
    }
}
