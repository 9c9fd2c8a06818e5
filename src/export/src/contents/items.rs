//! Photos of a run: their bytes, and for chosen ones what was decided on each.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::Digest;
use marf_cache::manifest::Row;
use marf_stage::{PHOTOS, VERDICTS, Verdict};

use marf_model::{Run, RunNode};

use super::entries::{Contents, ItemVerdict};
use super::file::{OBJECTS, Purpose, is_plain};
use super::objects::reader;
use super::sets::{rows, verdicts};
use crate::error::ExportError;

/// Adds the objects of all photos that sources brought in, or those of chosen ones with all verdicts on them.
///
/// # Errors
/// A set that cannot be read, or a chosen photo that no source has.
pub(super) fn add_photos(
    contents: &mut Contents,
    run: &Run<'_>,
    chosen: Option<&BTreeSet<&str>>,
) -> Result<(), ExportError> {
    let mut found: BTreeMap<String, Row> = BTreeMap::new();
    for node in &run.nodes {
        let photos = node.run.outputs.get(PHOTOS);
        let Some(photos) = photos.filter(|_| is_source(contents, node)) else {
            continue;
        };
        let what = format!("`{PHOTOS}` of `{}`", node.run.name);
        for row in rows(&photos.digest, &reader(run), &what)? {
            contents.photos.extend(row.blobs.values());
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
    add_chosen(contents, run, &found)
}

/// Returns true if a node brings photos in: it reads none.
fn is_source(contents: &Contents, node: &RunNode) -> bool {
    let action = contents.action(node);
    action.is_some_and(|action| !action.inputs.contains_key(PHOTOS))
}

fn add_chosen(
    contents: &mut Contents,
    run: &Run<'_>,
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
        let Some(output) = node.run.outputs.get(VERDICTS) else {
            continue;
        };
        let what = format!("`{VERDICTS}` of `{}`", node.run.name);
        let decided = verdicts(&output.digest, &reader(run), &what)?;
        for verdict in decided {
            if let Some(row) = chosen.get(&verdict.id) {
                add_verdict(contents, node, row, &verdict);
            }
        }
    }
    Ok(())
}

fn add_verdict(contents: &mut Contents, node: &RunNode, row: &Row, verdict: &Verdict) {
    // Names, sentences and finite numbers always serialise.
    let bytes = serde_json::to_vec(verdict).unwrap_or_default();
    let whole = format!("items/{}/{}.json", row.id, node.run.name);
    let mut path = if is_plain(&whole) {
        whole
    } else {
        format!("items/{}.json", Digest::from_content(whole.as_bytes()))
    };
    // A product of several files has a verdict on each.
    if contents.files.contains_key(&path) {
        path = format!("items/{}.json", Digest::from_content(&bytes));
    }
    contents.add_bytes(
        &path,
        &format!("verdict of `{}` on `{}`", node.run.name, row.id),
        bytes,
    );
    contents.items.push(ItemVerdict {
        id: row.id.clone(),
        node: node.run.name.clone(),
        path,
        blobs: row.blobs.clone(),
        is_source: is_source(contents, node),
    });
}
