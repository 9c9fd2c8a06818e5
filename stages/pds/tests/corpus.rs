//! The fuzzers' corpora, replayed through the same ways in.
#![allow(clippy::unwrap_used, reason = "helpers of tests are not seen as tests")]

use std::path::{Path, PathBuf};

use marf_pds::fuzzing::{TARGETS, Target};

/// The files of a target's corpus, by name.
fn corpus(target: &str) -> Vec<(PathBuf, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../fuzz/corpus")
        .join(target);
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.sort();
    let read = |path: PathBuf| (path.clone(), std::fs::read(path).unwrap());
    paths.into_iter().map(read).collect()
}

/// No panic, and at least one file of each corpus is accepted by its reader.
#[test]
fn every_file_of_a_corpus_is_read_or_refused() {
    for (name, target) in TARGETS {
        let files = corpus(name);
        assert!(files.len() >= 5, "{name}: {} files", files.len());
        let read = files.iter().filter(|(_, bytes)| target(bytes) > 0).count();
        assert!(
            read > 0 && read < files.len(),
            "{name}: {read} of {} are read",
            files.len()
        );
    }
}

/// Every cut of every file, and every file with each byte changed in turn: no panic, promises hold.
#[test]
fn every_cut_and_every_changed_byte_is_read_or_refused() {
    for (name, target) in TARGETS {
        for (_, bytes) in corpus(name) {
            for cut in 0..bytes.len() {
                target(&bytes[..cut]);
            }
            changed(target, &bytes);
        }
    }
}

fn changed(target: Target, bytes: &[u8]) {
    let mut copy = bytes.to_vec();
    for (index, byte) in bytes.iter().enumerate() {
        // A sign that ends things, a digit more or less, a byte that is not text.
        for other in [b'"', byte.wrapping_add(1), 0xff] {
            copy[index] = other;
            target(&copy);
        }
        copy[index] = *byte;
    }
}
