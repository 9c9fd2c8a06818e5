//! Files of archives that changed since a run read them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use marf_cache::Digest;
use marf_cache::file::{Links, Stoppable, open};
use marf_engine::{Cancel, document};
use marf_model::product::origins;
use marf_model::{Run, RunNode, unless_lost};
use marf_stage::{LOCK_FILE, Origin};
use marf_stages::PinnedProduct;
use serde::Serialize;
use serde_json::Value;

use crate::context::Context;
use crate::error::Error;

/// A file that an archive, or marf.lock, has otherwise than it was when it was read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Changed {
    /// Its name in the archive.
    pub file: String,
    /// The sol.
    pub sol: u32,
    /// The bytes that were used.
    pub used: Digest,
    /// What is otherwise now, one sentence each.
    pub now: Vec<String>,
}

/// Compares what the sources of a run read with the present state: servers with marf.lock, which notes later answers, folders with the
/// files. No server is asked.
///
/// # Errors
/// A store or a lock that cannot be read, the wish to stop.
pub fn since(context: &Context, lineage: &Run<'_>, nodes: &[&RunNode]) -> Result<Vec<Changed>, Error> {
    let base = context.folder();
    let pins = marf_stages::pinned_products(&base.join(LOCK_FILE));
    let pins = pins.map_err(|error| Error::failed(error.to_string()))?;
    let mut by_sol: BTreeMap<u32, Pins<'_>> = BTreeMap::new();
    for pin in &pins {
        let sol = by_sol.entry(pin.sol).or_default();
        sol.entry(&pin.name).or_default().push(pin);
    }
    let mut changed = Vec::new();
    for source in nodes.iter().filter(|node| node.is_source()) {
        let folder = folder_of(lineage, &source.run.name).map(|path| base.join(path));
        for part in unless_lost(source.parts(lineage.store()))?.into_iter().flatten() {
            for file in unless_lost(origins(lineage.store(), &part))?
                .into_iter()
                .flatten()
            {
                let now = match (&file.fetched, &folder) {
                    (Some(_), _) => of_lock(by_sol.get(&part.shard), &file),
                    (None, Some(folder)) if file.bytes.is_some() => {
                        of_folder(folder, &file, &context.cancel)?
                    }
                    _ => Vec::new(),
                };
                if !now.is_empty() {
                    changed.push(Changed {
                        file: file.file,
                        sol: part.shard,
                        used: file.blake3,
                        now,
                    });
                }
            }
        }
    }
    Ok(changed)
}

/// The pins of a sol by name. Several archives may have the same name.
type Pins<'a> = BTreeMap<&'a str, Vec<&'a PinnedProduct>>;

/// Returns the differences between the pins of a sol and the origin noted when the file was read. Empty if the sol has no pins, or if one
/// of several archives still has the file.
fn of_lock(sol: Option<&Pins<'_>>, file: &Origin) -> Vec<String> {
    let Some(pins) = sol else { return Vec::new() };
    let Some(pins) = pins.get(file.file.as_str()) else {
        return vec![format!("{LOCK_FILE} has no product of this name")];
    };
    let told: Vec<Vec<String>> = pins.iter().map(|pin| differences(pin, file)).collect();
    if told.iter().any(Vec::is_empty) {
        return Vec::new();
    }
    told.into_iter().next().unwrap_or_default()
}

fn differences(pin: &PinnedProduct, file: &Origin) -> Vec<String> {
    let mut now = Vec::new();
    let mut compare = |what: &str, was: Option<String>, is: Option<String>| {
        if let (Some(was), Some(is)) = (was, is)
            && was != is
        {
            now.push(format!("{LOCK_FILE} has {what} {is}, it was {was}"));
        }
    };
    compare(
        "blake3",
        Some(file.blake3.to_string()),
        Some(pin.blake3.to_string()),
    );
    let text = |number: u64| number.to_string();
    compare("bytes", file.bytes.map(text), Some(text(pin.bytes)));
    compare(
        "sha256",
        file.sha256.map(|sha256| sha256.to_string()),
        Some(pin.sha256.to_string()),
    );
    compare("url", file.url.clone(), pin.url.clone());
    compare("fetched", file.fetched.clone(), Some(pin.fetched.clone()));
    now.extend(
        pin.others
            .iter()
            .map(|other| format!("the archive has given other bytes since, blake3 {other}")),
    );
    now
}

fn of_folder(folder: &Path, file: &Origin, cancel: &Cancel) -> Result<Vec<String>, Error> {
    let read = open(&folder.join(&file.file), Links::Followed)
        .and_then(|file| Digest::from_reader(Stoppable::new(file, || cancel.is_set())));
    if cancel.is_set() {
        return Err(Error::Interrupted);
    }
    Ok(match read {
        Ok((now, _)) if now == file.blake3 => Vec::new(),
        Ok((now, _)) => vec![format!("the folder has other bytes now, blake3 {now}")],
        Err(error) => vec![format!("the folder has it no longer: {error}")],
    })
}

/// Returns the folder that a source read, if its archive is one, as the pipeline names it.
fn folder_of(lineage: &Run<'_>, source: &str) -> Option<PathBuf> {
    let resolved = lineage.record.documents.get(document::RESOLVED)?;
    let tree: Value = serde_json::from_slice(&lineage.store().get(&resolved.digest).ok()?).ok()?;
    let archive = tree["node"][source]["archive"].as_str()?;
    let table = &tree["archive"][archive];
    (table["kind"] == "folder")
        .then(|| table["path"].as_str().map(PathBuf::from))
        .flatten()
}

#[cfg(test)]
mod tests {
    use marf_stage::OriginKind;

    use super::*;

    #[test]
    fn a_file_that_is_read_when_the_user_stops_is_not_taken_for_a_changed_one() {
        let dir = tempfile::tempdir().unwrap();
        let bytes = vec![7; 40 << 20];
        std::fs::write(dir.path().join("a.png"), &bytes).unwrap();
        let file = Origin {
            file: "a.png".to_owned(),
            kind: OriginKind::Photo,
            blake3: Digest::from_content(&bytes),
            bytes: Some(bytes.len() as u64),
            sha256: None,
            url: None,
            fetched: None,
            reason: None,
        };
        assert_eq!(of_folder(dir.path(), &file, &Cancel::default()), Ok(Vec::new()));
        for checks in 0..3 {
            let cancel = Cancel::after(checks);
            assert_eq!(
                of_folder(dir.path(), &file, &cancel),
                Err(Error::Interrupted),
                "{checks}"
            );
        }
    }
}
