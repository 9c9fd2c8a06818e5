//! Two changes of the pins of one sol, by two processes: nothing that either pinned is lost.

use std::collections::{BTreeMap, BTreeSet};

use super::{Pin, SolPins};

/// What is said of one file.
#[derive(Debug, Clone, PartialEq)]
enum Entry {
    Pinned(Pin),
    LeftOut(String),
    Gone(u16),
}

/// Merges `ours` and `theirs`, which both come from `base`. Where both changed the same file to other bytes, those
/// that were written first stay in use and the others are kept with the pin.
pub(super) fn merge(base: &SolPins, ours: &SolPins, theirs: &SolPins) -> SolPins {
    if base == theirs || ours == theirs {
        return ours.clone();
    }
    let (before, mine, other) = (entries(base), entries(ours), entries(theirs));
    let names: BTreeSet<&String> = mine.keys().chain(other.keys()).collect();
    let mut merged = SolPins {
        complete: complete(base, ours, theirs),
        ..SolPins::default()
    };
    for name in names {
        let (old, mine, theirs) = (before.get(name), mine.get(name), other.get(name));
        let entry = match (mine, theirs) {
            (mine, theirs) if theirs == old => mine.cloned(),
            (mine, theirs) if mine == old => theirs.cloned(),
            (Some(mine), Some(theirs)) => Some(both(mine, theirs)),
            (one, None) | (None, one) => one.cloned(),
        };
        match entry {
            Some(Entry::Pinned(pin)) => drop(merged.files.insert(name.clone(), pin)),
            Some(Entry::LeftOut(why)) => drop(merged.left_out.insert(name.clone(), why)),
            Some(Entry::Gone(status)) => drop(merged.gone.insert(name.clone(), status)),
            None => {}
        }
    }
    merged
}

/// A pinned file goes before one that was left out, and that before one that could not be fetched.
fn both(ours: &Entry, theirs: &Entry) -> Entry {
    match (ours, theirs) {
        (Entry::Pinned(ours), Entry::Pinned(theirs)) => {
            let mut pin = theirs.clone();
            pin.others
                .extend(ours.others.iter().copied().chain([ours.blake3]));
            pin.others.remove(&theirs.blake3);
            Entry::Pinned(pin)
        }
        (_, Entry::Pinned(_)) | (Entry::Gone(_), Entry::LeftOut(_)) => theirs.clone(),
        _ => ours.clone(),
    }
}

/// A sol is complete where one of the two found it so, and they asked for the same.
fn complete(base: &SolPins, ours: &SolPins, theirs: &SolPins) -> Option<String> {
    match (&ours.complete, &theirs.complete) {
        (ours, theirs) if ours == theirs => ours.clone(),
        (ours, theirs) if *theirs == base.complete => ours.clone(),
        (ours, theirs) if *ours == base.complete => theirs.clone(),
        (Some(_), Some(_)) => None,
        (one, None) | (None, one) => one.clone(),
    }
}

fn entries(pins: &SolPins) -> BTreeMap<String, Entry> {
    let files = pins
        .files
        .iter()
        .map(|(name, pin)| (name, Entry::Pinned(pin.clone())));
    let left_out = pins
        .left_out
        .iter()
        .map(|(name, why)| (name, Entry::LeftOut(why.clone())));
    let gone = pins
        .gone
        .iter()
        .map(|(name, status)| (name, Entry::Gone(*status)));
    let all = gone.chain(left_out).chain(files);
    all.map(|(name, entry)| (name.clone(), entry)).collect()
}
