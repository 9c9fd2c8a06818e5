//! Photos of a run: their bytes, and for chosen ones what was decided on each.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::Digest;
use marf_cache::manifest::Row;
use marf_stage::{PHOTOS, VERDICTS, Verdict};

use super::{Contents, OBJECTS, Purpose, ReadObject, is_plain, rows, verdicts};
use crate::error::ExportError;
use crate::run::{Node, Run};

/// What a node decided on a chosen photo.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ItemVerdict {
    /// Id of the photo.
    pub id: String,
    /// Name of the node.
    pub node: String,
    /// Path of the file that holds the verdict.
    pub path: String,
    /// Objects of the photo by role (`image`, `label`).
    pub blobs: BTreeMap<String, Digest>,
    /// Whether the node is the one that brought the photo in.
    pub is_source: bool,
}

/// Adds the objects of all photos that sources brought in, or those of chosen ones with all verdicts on them.
///
/// # Errors
/// A set that cannot be read, or a chosen photo that no source has.
pub(super) fn add_photos(
    contents: &mut Contents,
    run: &Run,
    read: &ReadObject<'_>,
    chosen: Option<&BTreeSet<&str>>,
) -> Result<(), ExportError> {
    let mut found: BTreeMap<String, Row> = BTreeMap::new();
    for node in &run.nodes {
        let Some(photos) = node.outputs.get(PHOTOS).filter(|_| is_source(contents, node)) else {
            continue;
        };
        for row in rows(&photos.digest, read, &format!("`{PHOTOS}` of `{}`", node.name))? {
            match chosen {
                None => row
                    .blobs
                    .values()
                    .for_each(|blob| contents.add_object(*blob, Purpose::Data)),
                Some(ids) if ids.contains(row.id.as_str()) => drop(found.insert(row.id.clone(), row)),
                Some(_) => {}
            }
        }
    }
    let mut ids = chosen.into_iter().flatten();
    if let Some(id) = ids.find(|id| !found.contains_key(**id)) {
        return Err(ExportError::UnknownItem { id: (*id).to_owned() });
    }
    add_chosen(contents, run, read, &found)
}

/// Tells whether a node brings photos in: it reads none.
fn is_source(contents: &Contents, node: &Node) -> bool {
    let action = contents.actions.get(&node.key);
    action.is_some_and(|action| !action.inputs.contains_key(PHOTOS))
}

fn add_chosen(
    contents: &mut Contents,
    run: &Run,
    read: &ReadObject<'_>,
    chosen: &BTreeMap<String, Row>,
) -> Result<(), ExportError> {
    for (id, row) in chosen {
        for (role, digest) in &row.blobs {
            let path = format!("{OBJECTS}{digest}");
            contents.add(path, format!("{role} of `{id}`"), *digest, Purpose::Data);
        }
    }
    if chosen.is_empty() {
        return Ok(());
    }
    for node in &run.nodes {
        let Some(output) = node.outputs.get(VERDICTS) else {
            continue;
        };
        let decided = verdicts(&output.digest, read, &format!("`{VERDICTS}` of `{}`", node.name))?;
        for verdict in decided {
            if let Some(row) = chosen.get(&verdict.id) {
                add_verdict(contents, node, row, &verdict);
            }
        }
    }
    Ok(())
}

fn add_verdict(contents: &mut Contents, node: &Node, row: &Row, verdict: &Verdict) {
    // Names, sentences and finite numbers always serialise.
    let bytes = serde_json::to_vec(verdict).unwrap_or_default();
    let whole = format!("items/{}/{}.json", row.id, node.name);
    let mut path = match is_plain(&whole) {
        true => whole,
        false => format!("items/{}.json", Digest::of(whole.as_bytes())),
    };
    // A product of several files has a verdict on each.
    if contents.files.contains_key(&path) {
        path = format!("items/{}.json", Digest::of(&bytes));
    }
    contents.add_bytes(
        &path,
        &format!("verdict of `{}` on `{}`", node.name, row.id),
        bytes,
    );
    contents.items.push(ItemVerdict {
        id: row.id.clone(),
        node: node.name.clone(),
        path,
        blobs: row.blobs.clone(),
        is_source: is_source(contents, node),
    });
}
