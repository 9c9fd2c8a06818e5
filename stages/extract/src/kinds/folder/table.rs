//! Files of a folder as earlier runs knew them. A file whose state is unchanged is not read. The table is in the scratch folder,
//! and its loss costs only time.
//!
//! A file is not in the table if it was written less than one tick of the coarsest file systems before it was read.
//! Within that tick it could be written again without a trace in its state.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use marf_cache::Digest;
use marf_stage::OriginKind;
use serde::{Deserialize, Serialize};

use super::walk::WalkedFile;
use crate::archive::Known;
use crate::files::{read_checked, write_checked};
use crate::stat::FileState;

/// Raised when a table has another form or the kind of a file or its sol is decided in another way.
const FORM: u32 = 6;

/// Known files by name, each with its state.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Table(pub BTreeMap<String, (FileState, Known)>);

impl Table {
    /// Returns the path of the table of a folder. None for a run without a scratch folder.
    pub fn path(scratch: &Path, root: &Path, depth: usize) -> Option<PathBuf> {
        if scratch.as_os_str().is_empty() {
            return None;
        }
        let root = std::fs::canonicalize(root).unwrap_or_else(|_| root.to_owned());
        let key = format!("folder {FORM} {depth}\n{}", root.to_string_lossy());
        let name = Digest::from_content(key.as_bytes()).to_string();
        Some(scratch.join("folders").join(name))
    }

    /// Opens a table. Empty if it is absent or damaged.
    pub fn open(path: &Path) -> Self {
        let bytes = read_checked(path);
        bytes
            .and_then(|bytes| postcard::from_bytes(&bytes).ok())
            .unwrap_or_default()
    }

    /// Returns what is known of a file, if it has still this state.
    pub fn find(&self, name: &str, state: &FileState) -> Option<&Known> {
        let (known, entry) = self.0.get(name)?;
        (known == state).then_some(entry)
    }

    /// Returns the table of the files that had rested when the reading of the folder began.
    pub fn new(files: &[WalkedFile], known: &[Known], began_ns: i64) -> Self {
        let rested = |(file, known): (&WalkedFile, &Known)| {
            let state = *file.state.as_ref().ok().filter(|state| state.rested(began_ns))?;
            let readable = known.kind != OriginKind::Unreadable;
            readable.then(|| (file.name.clone(), (state, known.clone())))
        };
        Self(files.iter().zip(known).filter_map(rested).collect())
    }

    /// Writes the table.
    pub fn write(&self, path: &Path) {
        if let Ok(bytes) = postcard::to_allocvec(self) {
            write_checked(path, bytes);
        }
    }
}
