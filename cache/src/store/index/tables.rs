//! The tables of the index, the same in the file and in memory.
//!
//! An object is in a segment. A segment is a part of a pack file that begins at `base`. Packs are merged by joining
//! their bodies, which moves segments and no object: only rows of `segment` change.

use std::collections::BTreeSet;

use rusqlite::{Connection, OptionalExtension, Result, params};

use super::super::pack::{Entry, Kind};
use crate::Digest;

/// Version of the tables, kept in `user_version`.
pub(super) const VERSION: i64 = 1;

const SCHEMA: &str = "
CREATE TABLE IF NOT EXISTS segment(id INTEGER PRIMARY KEY, file TEXT NOT NULL, base INTEGER NOT NULL);
CREATE INDEX IF NOT EXISTS segment_file ON segment(file);
CREATE TABLE IF NOT EXISTS object(id BLOB NOT NULL, kind INTEGER NOT NULL, segment INTEGER NOT NULL,
  offset INTEGER NOT NULL, len INTEGER NOT NULL, generation INTEGER NOT NULL, PRIMARY KEY(id, kind)) WITHOUT ROWID;
PRAGMA user_version = 1;
";

/// Where the payload of an object is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in super::super) struct Location {
    /// Name of the pack file.
    pub(in super::super) file: String,
    pub(in super::super) offset: u64,
    pub(in super::super) len: u32,
    pub(in super::super) generation: u32,
}

/// A row of the table of objects.
#[derive(Debug, Clone, Copy)]
pub(in super::super) struct ObjectRow {
    pub(in super::super) kind: Kind,
    pub(in super::super) id: Digest,
    pub(in super::super) segment: i64,
    pub(in super::super) offset: u64,
    pub(in super::super) len: u32,
}

pub(super) fn create(connection: &Connection) -> Result<()> {
    connection.execute_batch(SCHEMA)
}

pub(super) fn version(connection: &Connection) -> Result<i64> {
    connection.query_row("PRAGMA user_version", [], |row| row.get(0))
}

pub(super) fn locate(connection: &Connection, kind: Kind, id: &Digest) -> Result<Option<Location>> {
    let mut statement = connection.prepare_cached(
        "SELECT s.file, s.base + o.offset, o.len, o.generation FROM object o JOIN segment s ON s.id = o.segment
         WHERE o.id = ?1 AND o.kind = ?2",
    )?;
    let row = |row: &rusqlite::Row<'_>| {
        Ok(Location {
            file: row.get(0)?,
            offset: unsigned(row.get(1)?),
            len: row.get(2)?,
            generation: row.get(3)?,
        })
    };
    statement
        .query_row(params![id.as_bytes(), kind.code()], row)
        .optional()
}

/// A number that the index holds as i64. A negative one, which nothing writes, becomes an offset past every file.
fn unsigned(value: i64) -> u64 {
    u64::try_from(value).unwrap_or(u64::MAX >> 1)
}

/// Returns the names of all registered packs.
pub(super) fn packs(connection: &Connection) -> Result<BTreeSet<String>> {
    let mut statement = connection.prepare_cached("SELECT DISTINCT file FROM segment")?;
    statement.query_map([], |row| row.get(0))?.collect()
}

/// Registers a pack with its entries, unless it is registered. Returns whether it was not.
pub(super) fn adopt(connection: &Connection, file: &str, entries: &[Entry]) -> Result<bool> {
    let known: i64 = connection
        .prepare_cached("SELECT count(*) FROM segment WHERE file = ?1")?
        .query_row([file], |row| row.get(0))?;
    if known > 0 {
        return Ok(false);
    }
    let segment = add_segment(connection, file, 0)?;
    let mut sorted: Vec<&Entry> = entries.iter().collect();
    sorted.sort_unstable_by_key(|entry| (entry.id, entry.kind));
    let mut statement = connection.prepare_cached(
        "INSERT INTO object(id, kind, segment, offset, len, generation) VALUES(?1, ?2, ?3, ?4, ?5, ?6)
         ON CONFLICT(id, kind) DO UPDATE SET segment = excluded.segment, offset = excluded.offset, len = excluded.len,
         generation = excluded.generation WHERE excluded.generation > generation",
    )?;
    for entry in sorted {
        statement.execute(params![
            entry.id.as_bytes(),
            entry.kind.code(),
            segment,
            entry.offset as i64,
            entry.len,
            entry.generation
        ])?;
    }
    Ok(true)
}

fn add_segment(connection: &Connection, file: &str, base: i64) -> Result<i64> {
    connection
        .prepare_cached("INSERT INTO segment(file, base) VALUES(?1, ?2)")?
        .execute(params![file, base])?;
    Ok(connection.last_insert_rowid())
}

/// Drops packs with all their rows.
pub(super) fn forget(connection: &Connection, files: &BTreeSet<String>) -> Result<()> {
    for file in files {
        connection.execute(
            "DELETE FROM object WHERE segment IN (SELECT id FROM segment WHERE file = ?1)",
            [file],
        )?;
        connection.execute("DELETE FROM segment WHERE file = ?1", [file])?;
    }
    Ok(())
}

/// Registers that the bodies of packs are now in another pack, each moved by `by` bytes. A pack that is no longer
/// registered is an error: its rows would be lost.
pub(super) fn join(connection: &Connection, into: &str, moved: &[(String, u64)]) -> Result<()> {
    for (file, by) in moved {
        let changed = connection.execute(
            "UPDATE segment SET file = ?1, base = base + ?2 WHERE file = ?3",
            params![into, *by as i64, file],
        )?;
        if changed == 0 {
            return Err(rusqlite::Error::QueryReturnedNoRows);
        }
    }
    Ok(())
}

/// Registers that the objects of a pack that still have a row there are now in another, at these places. Drops the
/// first.
pub(super) fn rewrite(connection: &Connection, from: &str, into: &str, entries: &[Entry]) -> Result<()> {
    let segment = add_segment(connection, into, 0)?;
    {
        let mut statement = connection.prepare_cached(
            "UPDATE object SET segment = ?1, offset = ?2, len = ?3 WHERE id = ?4 AND kind = ?5
             AND segment IN (SELECT id FROM segment WHERE file = ?6)",
        )?;
        for entry in entries {
            statement.execute(params![
                segment,
                entry.offset as i64,
                entry.len,
                entry.id.as_bytes(),
                entry.kind.code(),
                from
            ])?;
        }
    }
    forget(connection, &BTreeSet::from([from.to_owned()]))
}

/// A pack whose living objects were written to another: the names of both, and their places there.
pub(in super::super) struct PackRewrite {
    pub(in super::super) from: String,
    /// Empty if nothing lived.
    pub(in super::super) into: String,
    pub(in super::super) entries: Vec<Entry>,
}

/// Registers the new places of the objects of some packs, and drops these packs. If these packs have rows of other
/// objects, nothing changes and an error is returned.
pub(super) fn compact(connection: &Connection, packs: &[PackRewrite]) -> Result<()> {
    let mut all = Vec::new();
    for pack in packs {
        let mut statement = connection.prepare_cached("SELECT id FROM segment WHERE file = ?1")?;
        let ids = statement.query_map([&pack.from], |row| row.get::<_, i64>(0))?;
        all.extend(ids.collect::<Result<Vec<_>>>()?);
    }
    let list: Vec<String> = all.iter().map(i64::to_string).collect();
    let list = list.join(",");
    let rows: i64 = connection.query_row(
        &format!("SELECT count(*) FROM object WHERE segment IN ({list})"),
        [],
        |row| row.get(0),
    )?;
    let moved: usize = packs.iter().map(|pack| pack.entries.len()).sum();
    if rows != moved as i64 {
        return Err(rusqlite::Error::QueryReturnedNoRows);
    }
    let mut statement = connection.prepare(&format!(
        "UPDATE object SET segment = ?1, offset = ?2, len = ?3 WHERE id = ?4 AND kind = ?5 AND segment IN ({list})"
    ))?;
    for pack in packs.iter().filter(|pack| !pack.entries.is_empty()) {
        let segment = add_segment(connection, &pack.into, 0)?;
        for entry in &pack.entries {
            let changed = statement.execute(params![
                segment,
                entry.offset as i64,
                entry.len,
                entry.id.as_bytes(),
                entry.kind.code()
            ])?;
            if changed == 0 {
                return Err(rusqlite::Error::QueryReturnedNoRows);
            }
        }
    }
    for pack in packs {
        connection.execute("DELETE FROM segment WHERE file = ?1", [&pack.from])?;
    }
    Ok(())
}

/// Drops the row of an object.
pub(super) fn remove(connection: &Connection, kind: Kind, id: &Digest) -> Result<()> {
    connection
        .prepare_cached("DELETE FROM object WHERE id = ?1 AND kind = ?2")?
        .execute(params![id.as_bytes(), kind.code()])?;
    Ok(())
}

/// Calls `each` with all objects, sorted by id.
pub(super) fn for_each(connection: &Connection, each: &mut dyn FnMut(ObjectRow)) -> Result<()> {
    let mut statement =
        connection.prepare_cached("SELECT id, kind, segment, offset, len FROM object ORDER BY id, kind")?;
    let mut rows = statement.query([])?;
    while let Some(row) = rows.next()? {
        let id: [u8; 32] = row.get(0)?;
        let Some(kind) = Kind::from_code(row.get(1)?) else {
            continue;
        };
        each(ObjectRow {
            kind,
            id: Digest::from_bytes(id),
            segment: row.get(2)?,
            offset: unsigned(row.get(3)?),
            len: row.get(4)?,
        });
    }
    Ok(())
}

/// Returns the ids of all objects of a kind, sorted.
pub(super) fn ids(connection: &Connection, kind: Kind) -> Result<Vec<Digest>> {
    let mut statement = connection.prepare_cached("SELECT id FROM object WHERE kind = ?1 ORDER BY id")?;
    let ids = statement.query_map([kind.code()], |row| row.get(0).map(Digest::from_bytes))?;
    ids.collect()
}

/// Returns the pack file and the base of each segment.
pub(super) fn segments(connection: &Connection) -> Result<Vec<(i64, String, u64)>> {
    let mut statement = connection.prepare_cached("SELECT id, file, base FROM segment")?;
    let rows = statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?, unsigned(row.get(2)?))))?;
    rows.collect()
}
