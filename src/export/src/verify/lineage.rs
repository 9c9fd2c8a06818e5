//! Lineage: from results back to the files of an archive.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::manifest::Row;
use marf_cache::{Action, Digest};
use marf_engine::{LISTING, NodeRun};
use marf_stage::{COMPANIONS, EARLIER, Origin, PHOTOS, VERDICTS};

use super::open::{OpenCrate, text};
use crate::contents::{leaves, rows};
use crate::graph::{action_id, ids, root_name};

/// Checks that inputs were made, and that photos come from files. Returns how many photos were followed.
pub(super) fn check(opened: &OpenCrate, faults: &mut Vec<String>) -> u64 {
    check_root(opened, faults);
    let actions: BTreeMap<&str, Action> = opened
        .run
        .nodes
        .iter()
        .filter_map(|node| Some((node.name.as_str(), opened.action(node).ok()?)))
        .collect();
    check_inputs(opened, &actions, faults);
    check_sets(opened, &actions, faults);
    check_verdicts(opened, faults);
    check_origins(opened, &actions, faults)
}

/// The graph and the bag name the run root by its digest.
fn check_root(opened: &OpenCrate, faults: &mut Vec<String>) {
    let name = root_name(&opened.run);
    let root = opened.entities.iter().find(|entity| text(entity, "@id") == "./");
    if root.is_none_or(|root| text(root, "identifier") != name) {
        faults.push("the graph names another run root".to_owned());
    }
    let info = opened.bag.tag("bag-info.txt").unwrap_or_default();
    let told = format!("External-Identifier: {name}");
    if !String::from_utf8_lossy(&info).lines().any(|line| line == told) {
        faults.push("`bag-info.txt` names another run root".to_owned());
    }
}

/// Checks that an earlier node or its children made each input, or that an input from outside is in the
/// crate.
fn check_inputs(opened: &OpenCrate, actions: &BTreeMap<&str, Action>, faults: &mut Vec<String>) {
    let mut made: BTreeSet<Digest> = BTreeSet::new();
    for node in &opened.run.nodes {
        let inputs = actions.get(node.name.as_str()).map(|action| &action.inputs);
        for (name, digest) in inputs.into_iter().flatten() {
            // An input that a parent gives to a child need not be an output.
            let is_foreign = matches!(name.as_str(), LISTING | COMPANIONS | EARLIER) || node.parent.is_some();
            match (made.contains(digest), is_foreign) {
                (true, _) => {}
                (false, true) if opened.holds(digest) => {}
                (false, true) => {
                    faults.push(format!("input `{name}` of `{}` is not in the crate", node.name))
                }
                (false, false) => faults.push(format!("no node made input `{name}` of `{}`", node.name)),
            }
        }
        made.extend(node.outputs.values().map(|output| output.digest));
    }
}

/// Checks that the photos of a node are among those it read, with the same bytes, and that all sets are
/// whole.
fn check_sets(opened: &OpenCrate, actions: &BTreeMap<&str, Action>, faults: &mut Vec<String>) {
    for node in &opened.run.nodes {
        let out = match opened.photos(node) {
            Ok(Some(photos)) => photos,
            Ok(None) => continue,
            Err(error) => {
                faults.push(error.to_string());
                continue;
            }
        };
        let input = actions
            .get(node.name.as_str())
            .and_then(|action| action.inputs.get(PHOTOS));
        let Some(input) = input else { continue };
        let read = rows(input, &|digest| opened.object(digest), "a set of photos").unwrap_or_default();
        let read: BTreeMap<String, Row> = read.into_iter().map(|row| (row.id.clone(), row)).collect();
        let foreign = out
            .iter()
            .find(|row| read.get(&row.id).is_none_or(|known| known.blobs != row.blobs));
        if let Some(row) = foreign {
            faults.push(format!(
                "`{}` lets `{}` through, which it did not read",
                node.name, row.id
            ));
        }
    }
}

/// Verdicts of single photos are lines of a node's verdicts.
fn check_verdicts(opened: &OpenCrate, faults: &mut Vec<String>) {
    let mut lines: BTreeSet<Digest> = BTreeSet::new();
    for node in &opened.run.nodes {
        let Some(output) = node.outputs.get(VERDICTS) else {
            continue;
        };
        let read = |digest: &Digest| opened.object(digest);
        let what = format!("`{VERDICTS}` of `{}`", node.name);
        match leaves(&output.digest, &read, &what) {
            Err(error) => faults.push(error.to_string()),
            Ok(leaves) => {
                for leaf in leaves {
                    match opened.object(&leaf.leaf) {
                        Ok(bytes) => {
                            lines.extend(bytes.split(|byte| *byte == b'\n').map(Digest::from_content))
                        }
                        Err(cause) => faults.push(format!("a leaf of {what}: {cause}")),
                    }
                }
            }
        }
    }
    for (path, digest) in &opened.bag.payload {
        if path.starts_with("items/") && !lines.contains(&digest.blake3) {
            faults.push(format!("`{path}` is not a verdict of the run"));
        }
    }
}

/// Returns the files that a source read, by the digest of their bytes, as the graph lists them.
pub(super) fn origins(
    opened: &OpenCrate,
    node: &NodeRun,
    action: &Action,
) -> Result<BTreeMap<Digest, Origin>, String> {
    let id = action_id(&node.name);
    let entity = opened.entities.iter().find(|entity| text(entity, "@id") == id);
    let objects = entity.map(|entity| ids(&entity["object"])).unwrap_or_default();
    let described = opened.described();
    let mut origins = BTreeMap::new();
    for object in objects {
        let Some(file) = described.get(object) else {
            continue;
        };
        if action.inputs.values().any(|digest| *digest == file.blake3) {
            continue;
        }
        let bytes = opened.object(&file.blake3)?;
        let listed =
            Origin::decode(&bytes).map_err(|error| format!("`{object}` is not a list of files: {error}"))?;
        origins.extend(listed.into_iter().map(|origin| (origin.blake3, origin)));
    }
    Ok(origins)
}

/// Every photo that a source brought in is a file that it read, or was made of one.
fn check_origins(opened: &OpenCrate, actions: &BTreeMap<&str, Action>, faults: &mut Vec<String>) -> u64 {
    let mut followed = 0;
    for node in &opened.run.nodes {
        let Some(action) = actions.get(node.name.as_str()) else {
            continue;
        };
        if !action.inputs.contains_key(LISTING) {
            continue;
        }
        let origins = match origins(opened, node, action) {
            Ok(origins) => origins,
            Err(cause) => {
                faults.push(format!("what `{}` read: {cause}", node.name));
                continue;
            }
        };
        // A run that did not note its files gives no origins.
        let is_told = !origins.is_empty();
        for row in opened.rows(node).iter().filter(|_| is_told) {
            let mut files = ["raw", "image"].iter().filter_map(|role| row.blobs.get(*role));
            if files.any(|digest| origins.contains_key(digest)) {
                followed += 1;
            } else {
                faults.push(format!("no file of the archive gave `{}`", row.id));
            }
        }
    }
    followed
}
