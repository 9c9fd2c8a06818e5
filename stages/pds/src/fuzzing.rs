//! Entry points of fuzzers: one function per reader of untrusted bytes. Not part of the public interface.
//!
//! Each returns how much it read, so that nothing is optimised away, and panics if a property that holds for every
//! input is broken.
#![allow(
    clippy::panic,
    clippy::assertions_on_constants,
    reason = "a broken promise must stop the fuzzer, and the program never calls this"
)]

use crate::{dat, feed, listing, odl, pds4, raw, vicar};

/// A reader of untrusted bytes.
pub type Target = fn(&[u8]) -> usize;

/// All targets with the names of their corpora.
pub const TARGETS: [(&str, Target); 6] = [
    ("dat", dat),
    ("listing", listing),
    ("odl", odl),
    ("pds4", pds4),
    ("vicar", vicar),
    ("feed", feed),
];

/// Decompresses a product of Mastcam, MAHLI or MARDI.
pub fn dat(bytes: &[u8]) -> usize {
    let Some(Ok(made)) = dat::decompress(bytes, 1 << 24) else {
        return 0;
    };
    let [bands, lines, samples] = made.array.shape.map(|side| side as usize);
    let needed = bands * lines * samples * made.array.sample.bytes as usize;
    assert_eq!(made.bytes.len(), needed, "whole");
    needed
}

/// Reads a folder page.
pub fn listing(bytes: &[u8]) -> usize {
    let Ok(entries) = listing::read(bytes) else {
        return 0;
    };
    for pair in entries.windows(2) {
        assert!(pair[0].name < pair[1].name, "sorted, each once");
    }
    let timed = |entry: &&listing::Entry| entry.modified.as_ref().is_some_and(|time| time.len() == 16);
    for entry in &entries {
        assert!(listing::is_plain(entry.name.as_bytes()), "plain");
        assert!(entry.modified.is_none() || timed(&entry), "a time is whole");
    }
    entries.iter().filter(|entry| entry.folder).count() + entries.len()
}

/// Reads a PDS3 or ODL label, attached or detached.
pub fn odl(bytes: &[u8]) -> usize {
    let groups = odl::parse(bytes).map_or(0, |group| group.descendants().len());
    groups + usize::from(raw::head(bytes).is_ok())
}

/// Reads a PDS4 label.
pub fn pds4(bytes: &[u8]) -> usize {
    pds4::read(bytes).map_or(0, |label| 1 + label.notes.len())
}

/// Reads a VICAR label.
pub fn vicar(bytes: &[u8]) -> usize {
    let groups = vicar::parse(bytes).map_or(0, |group| group.descendants().len());
    groups + usize::from(raw::head(bytes).is_ok())
}

/// Reads a record of a raw-image feed.
pub fn feed(bytes: &[u8]) -> usize {
    feed::read(bytes).map_or(0, |label| 1 + label.notes.len())
}
