//! Files of archives that are not what they were when a run read them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use marf_cache::Digest;
use marf_engine::document;
use marf_provenance::lineage::{Lineage, NodeLineage};
use marf_provenance::product::{origins, parts};
use marf_provenance::unless_lost;
use marf_stage::{LOCK_FILE, Origin};
use serde::Serialize;
use serde_json::Value;

use crate::cli::args::Global;
use crate::cli::error::CliError;

/// A file that an archive changed after it was read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Changed {
    /// Its name in the archive.
    pub file: String,
    /// The sol.
    pub sol: u32,
    /// The bytes that were used.
    pub used: Digest,
    /// What the archive gave under the same name since; empty if it has it no longer.
    pub now: Vec<Digest>,
}

/// Compares what the sources of a run read with what is there now: of servers with what marf.lock notes of later answers (no
/// server is asked), of folders with the files.
///
/// # Errors
/// A store or a lock that cannot be read.
pub fn since(
    global: &Global,
    lineage: &Lineage<'_>,
    nodes: &[&NodeLineage],
) -> Result<Vec<Changed>, CliError> {
    let base = global.file.parent().unwrap_or(Path::new(""));
    let pins = marf_stages::pins_by_name(&base.join(LOCK_FILE))
        .map_err(|error| CliError::failed(error.to_string()))?;
    let mut changed = Vec::new();
    for source in nodes.iter().filter(|node| node.is_source()) {
        let folder = folder_of(lineage, &source.run.name).map(|path| base.join(path));
        for part in unless_lost(parts(lineage.store(), source))?.into_iter().flatten() {
            for file in unless_lost(origins(lineage.store(), &part))?
                .into_iter()
                .flatten()
            {
                let now = match (&file.fetched, &folder) {
                    (Some(_), _) => of_lock(&pins, part.shard, &file),
                    (None, Some(folder)) if file.bytes.is_some() => of_folder(folder, &file),
                    _ => None,
                };
                changed.extend(now.map(|now| Changed {
                    file: file.file,
                    sol: part.shard,
                    used: file.blake3,
                    now,
                }));
            }
        }
    }
    Ok(changed)
}

/// Returns what marf.lock knows of other bytes under the name of a file; none if there are none.
fn of_lock(pins: &BTreeMap<(u32, String), Vec<Digest>>, sol: u32, file: &Origin) -> Option<Vec<Digest>> {
    let given = pins.get(&(sol, file.file.clone()))?;
    let others: Vec<Digest> = given
        .iter()
        .copied()
        .filter(|digest| *digest != file.blake3)
        .collect();
    (!others.is_empty()).then_some(others)
}

fn of_folder(folder: &Path, file: &Origin) -> Option<Vec<Digest>> {
    match std::fs::read(folder.join(&file.file)) {
        Ok(bytes) => {
            let now = Digest::of(&bytes);
            (now != file.blake3).then(|| vec![now])
        }
        Err(_) => Some(Vec::new()),
    }
}

/// Returns the folder that a source read, if its archive is one, as the pipeline names it.
fn folder_of(lineage: &Lineage<'_>, source: &str) -> Option<PathBuf> {
    let resolved = lineage.run.documents.get(document::RESOLVED)?;
    let tree: Value = serde_json::from_slice(&lineage.store().get(&resolved.digest).ok()?).ok()?;
    let archive = tree["node"][source]["archive"].as_str()?;
    let table = &tree["archive"][archive];
    (table["kind"] == "folder")
        .then(|| table["path"].as_str().map(PathBuf::from))
        .flatten()
}
