//! Which program runs, to the byte.

use std::path::Path;

use marf_cache::file::{self, FileKind, Links};
use marf_cache::{Digest, Store};
use marf_engine::Build;
use serde::{Deserialize, Serialize};

use crate::file_state::{FileState, state_of};
use crate::files;

/// The program with its version, as records name it.
pub const PROGRAM: &str = concat!("marf ", env!("CARGO_PKG_VERSION"));

/// The digest of the program's file, and the file's state when it was read.
#[derive(Debug, Serialize, Deserialize)]
struct ProgramFile {
    state: FileState,
    blake3: Digest,
    bytes: u64,
}

/// Returns the identity of the program's file, with the commit that it is built from. None if the system does not report the file, or it
/// cannot be read.
///
/// The digest of 100 MB takes 20 ms, so it is kept in the scratch folder of the store with the state of the file.
pub fn build(store: &Store, commit: Option<&str>) -> Option<Build> {
    let path = std::env::current_exe().ok()?;
    let table = store.scratch().join("program.json");
    let state = state_of(&path)?;
    let known = file::read(&table, FileKind::Document, Links::Followed)
        .ok()
        .and_then(|bytes| serde_json::from_slice::<ProgramFile>(&bytes).ok())
        .filter(|known| known.state == state);
    let known = match known {
        Some(known) => known,
        None => read(&path, state, &table)?,
    };
    Some(Build {
        commit: commit.map(str::to_owned),
        blake3: known.blake3,
        bytes: known.bytes,
        os: std::env::consts::OS.to_owned(),
        arch: std::env::consts::ARCH.to_owned(),
    })
}

fn read(path: &Path, state: FileState, table: &Path) -> Option<ProgramFile> {
    let (blake3, bytes) = Digest::from_reader(file::open(path, Links::Followed).ok()?).ok()?;
    let known = ProgramFile { state, blake3, bytes };
    if let Ok(json) = serde_json::to_vec(&known) {
        let _ = files::write(table, &json); // what cannot be kept is read again
    }
    Some(known)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_program_is_known_by_its_digest_and_read_once() {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::open(dir.path()).unwrap();
        let first = build(&store, None).unwrap();
        let exe = std::fs::read(std::env::current_exe().unwrap()).unwrap();
        assert_eq!(
            (first.blake3, first.bytes),
            (Digest::from_content(&exe), exe.len() as u64)
        );
        let table = store.scratch().join("program.json");
        let mut known: ProgramFile = serde_json::from_slice(&std::fs::read(&table).unwrap()).unwrap();
        known.blake3 = Digest::from_content(b"kept");
        std::fs::write(&table, serde_json::to_vec(&known).unwrap()).unwrap();
        assert_eq!(build(&store, None).unwrap().blake3, Digest::from_content(b"kept"));
        known.state = state_of(&table).unwrap();
        std::fs::write(&table, serde_json::to_vec(&known).unwrap()).unwrap();
        assert_eq!(build(&store, None), Some(first), "another file is read again");
    }
}
