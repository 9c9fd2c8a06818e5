//! The graph against itself and the bag.

use std::collections::BTreeSet;

use marf_cache::Digest;

use super::open::{OpenCrate, text};
use crate::contents::OBJECTS;
use crate::crates::name_of;
use crate::graph::{METADATA, references};

/// A page for people that crates had until 0.2.0. The graph names it, but does not describe it as a file.
const PREVIEW: &str = "ro-crate-preview.html";

/// Returns the faults: duplicate ids, references to nothing, files with other digests than given, files that
/// the graph does not describe.
pub(super) fn check(opened: &OpenCrate) -> Vec<String> {
    let mut faults = Vec::new();
    let mut ids: BTreeSet<&str> = BTreeSet::new();
    for entity in &opened.entities {
        let id = text(entity, "@id");
        if id.is_empty() || !ids.insert(id) {
            faults.push(format!("the graph has no id or two entities `{id}`"));
        }
    }
    for entity in &opened.entities {
        let dangling = references(entity).into_iter().filter(|(_, id)| !ids.contains(id));
        faults.extend(dangling.map(|(field, id)| {
            format!(
                "`{field}` of `{}` refers to `{id}`, which is not in the graph",
                text(entity, "@id")
            )
        }));
    }
    faults.extend(check_files(opened));
    faults.extend(check_untold(opened));
    faults
}

fn check_files(opened: &OpenCrate) -> Vec<String> {
    let mut faults = Vec::new();
    let described = opened.described();
    for file in opened.of_type("File") {
        let id = text(file, "@id");
        let Some(told) = described.get(id) else {
            faults.push(format!("the graph gives no length and digests of `{id}`"));
            continue;
        };
        match (opened.bag.payload.get(id), id.contains(':')) {
            (Some(found), _) if found == told => {}
            (Some(_), _) => faults.push(format!(
                "`{id}` has another length or digest than the graph gives"
            )),
            (None, true) if id == name_of(&told.sha256) => {}
            (None, true) => faults.push(format!(
                "`{id}` is not the name of the SHA-256 that the graph gives"
            )),
            (None, false) => faults.push(format!("the graph describes `{id}`, which is not in the bag")),
        }
    }
    faults
}

/// Finds files of the payload that the graph does not describe, and objects whose name is not their digest.
fn check_untold(opened: &OpenCrate) -> Vec<String> {
    let described = opened.described();
    let mut faults = Vec::new();
    for (path, digest) in &opened.bag.payload {
        let is_told = described.contains_key(path.as_str()) || matches!(path.as_str(), METADATA | PREVIEW);
        match path.strip_prefix(OBJECTS) {
            Some(name) if name.parse::<Digest>() == Ok(digest.blake3) => {}
            Some(_) => faults.push(format!("`{path}` is not named by its blake3 digest")),
            None if is_told => {}
            None => faults.push(format!("the graph does not describe `{path}`")),
        }
    }
    faults
}
