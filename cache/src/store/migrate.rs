//! Stores of 0.1.0: blobs stay where they are, records are made again.

use std::path::Path;

use serde_json::Value;

use super::{Kind, Store, StoreError, files::Files, format, notices::Notices, pack, runs};

/// A node whose result must be made again.
#[derive(Debug, Clone, PartialEq)]
pub struct MigratedNode {
    /// Its name in the newest run of the old store.
    pub name: String,
    /// How long it took then.
    pub seconds: f64,
}

/// What a migration keeps, and what it does not.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Migration {
    /// Blobs that stay; what was fetched is among them.
    pub blobs: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Run roots that stay readable.
    pub runs: u64,
    /// Nodes whose results must be made again: keys are computed in another way.
    pub nodes: Vec<MigratedNode>,
}

impl Store {
    /// Tells what a migration of the store in a folder would do; all zero if there is nothing to migrate.
    ///
    /// # Errors
    /// A folder that cannot be read, and a store of a later form.
    pub fn plan_migration(dir: &Path) -> Result<Migration, StoreError> {
        plan(&Files::of_disk(), dir)
    }

    /// Makes a store of 0.1.0 one of this form. Blobs and run roots stay, the old index goes to `bad/`. It may be
    /// repeated after a crash, and does nothing to a store of this form.
    ///
    /// # Errors
    /// A folder that cannot be read or written, and a store of a later form.
    pub fn migrate(dir: &Path) -> Result<Migration, StoreError> {
        migrate_on(&Files::of_disk(), dir)
    }
}

/// As [`Store::migrate`], on these files.
pub(super) fn migrate_on(files: &Files, dir: &Path) -> Result<Migration, StoreError> {
    let migration = plan(files, dir)?;
    if format::find(files, dir)? != format::Found::Old {
        return Ok(migration);
    }
    // Until `format` is written the folder is one of 0.1.0 by its packs, or an empty one with its blobs.
    let index = dir.join("index.redb");
    if files.meta(&index).is_some() {
        files.quarantine(dir, &index, "index.redb")?;
    }
    let notices = Notices::default();
    super::open::write_format(dir, files, &notices)?;
    Ok(migration)
}

fn plan(files: &Files, dir: &Path) -> Result<Migration, StoreError> {
    let found = format::find(files, dir)?;
    if found != format::Found::Old {
        format::check(dir, found)?;
        return Ok(Migration::default());
    }
    let mut migration = Migration::default();
    count_packed(files, dir, &mut migration)?;
    count_loose(files, dir, &mut migration)?;
    let runs_dir = dir.join("runs");
    let runs = runs::list(files, &runs_dir)?;
    migration.runs = runs.len() as u64;
    for run in runs.iter().rev() {
        let Ok(bytes) = runs::read(files, &runs_dir, run)? else {
            continue;
        };
        if let Some(nodes) = nodes_of(&bytes) {
            migration.nodes = nodes;
            break;
        }
    }
    Ok(migration)
}

fn count_packed(files: &Files, dir: &Path, migration: &mut Migration) -> Result<(), StoreError> {
    let packs = dir.join("packs");
    for name in files.names(&packs)?.iter().filter(|name| name.ends_with(".pack")) {
        let contents = pack::contents(files, &packs.join(name))?;
        let entries = contents.into_iter().flat_map(|contents| contents.entries);
        for entry in entries.filter(|entry| entry.kind == Kind::Blob) {
            migration.blobs += 1;
            migration.bytes += u64::from(entry.len);
        }
    }
    Ok(())
}

fn count_loose(files: &Files, dir: &Path, migration: &mut Migration) -> Result<(), StoreError> {
    let cas = dir.join("cas");
    for folder in files.names(&cas)? {
        let folder = cas.join(folder);
        for name in files.names(&folder)? {
            migration.blobs += 1;
            migration.bytes += files.meta(&folder.join(name)).map_or(0, |meta| meta.bytes);
        }
    }
    Ok(())
}

/// Returns the nodes that have a result in a run root of 0.1.0.
fn nodes_of(root: &[u8]) -> Option<Vec<MigratedNode>> {
    let root: Value = serde_json::from_slice(root).ok()?;
    let nodes = root.get("nodes")?.as_array()?.iter();
    let with_result = nodes.filter(|node| {
        node.get("outputs")
            .and_then(Value::as_object)
            .is_some_and(|outputs| !outputs.is_empty())
    });
    let named = with_result.filter_map(|node| {
        Some(MigratedNode {
            name: node.get("name")?.as_str()?.to_owned(),
            seconds: node.get("seconds").and_then(Value::as_f64).unwrap_or(0.0),
        })
    });
    Some(named.collect())
}
