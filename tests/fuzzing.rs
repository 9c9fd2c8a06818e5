//! The fuzzers' corpora, replayed through the same entry points within a time for each input. Those of labels and pages are replayed by
//! `marf-pds`.
#![allow(clippy::unwrap_used, reason = "helpers of tests are not seen as tests")]

#[path = "../fuzz/src/lib.rs"]
mod fuzz;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use fuzz::{TARGETS, Target};

/// Longest time for an input of a corpus, all of which are small. Other tests run at the same time.
const LONGEST: Duration = Duration::from_secs(2);

/// The files of a target's corpus, by name.
fn corpus(target: &str) -> Vec<(PathBuf, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("fuzz/corpus")
        .join(target);
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.sort();
    let read = |path: PathBuf| (path.clone(), std::fs::read(path).unwrap());
    paths.into_iter().map(read).collect()
}

/// Reads an input, within the time.
fn read(name: &str, target: Target, bytes: &[u8]) -> usize {
    let start = Instant::now();
    let count = target(bytes);
    let taken = start.elapsed();
    assert!(taken < LONGEST, "{name}: {taken:?} for {bytes:?}");
    count
}

#[test]
fn every_file_of_a_corpus_is_read_or_refused_in_time() {
    for (name, target) in TARGETS {
        let files = corpus(name);
        assert!(files.len() >= 5, "{name}: {} files", files.len());
        let count = files
            .iter()
            .filter(|(_, bytes)| read(name, target, bytes) > 0)
            .count();
        assert!(
            count > 0 && count < files.len(),
            "{name}: {count} of {} are read",
            files.len()
        );
    }
}

/// Every cut of every file, and every file with each byte changed in turn: no panic.
#[test]
fn every_cut_and_every_changed_byte_is_read_or_refused_in_time() {
    for (name, target) in TARGETS {
        for (_, bytes) in corpus(name) {
            for cut in 0..bytes.len() {
                read(name, target, &bytes[..cut]);
            }
            let mut copy = bytes.clone();
            for (index, byte) in bytes.iter().enumerate() {
                // A sign that ends things, a digit more, a large number.
                for other in [b'"', byte.wrapping_add(1), 0xff] {
                    copy[index] = other;
                    read(name, target, &copy);
                }
                copy[index] = *byte;
            }
        }
    }
}
