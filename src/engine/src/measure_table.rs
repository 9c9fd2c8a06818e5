//! Tables of measures: all measures of one kind of the rows of one shard, of all runs.
//!
//! Each value is a pure function of its row, so earlier runs decide only what is measured again.

use std::{collections::BTreeMap, sync::Arc};

use marf_cache::{Digest, canonical_json, manifest::Row};
use marf_stage::Table;
use serde_json::json;

const MAGIC: &[u8; 12] = b"marf-memo-1\n";

/// Measures by [`row_digest`].
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct MeasureTable(pub(crate) BTreeMap<Digest, Arc<[u8]>>);

/// Returns the digest of everything that a measure can read of a row: its id, its blobs, its facts.
///
/// A stage is given the id and may use it, so a renamed photo is measured again.
pub(crate) fn row_digest(row: &Row) -> Digest {
    // Strings, digests and sorted maps always serialise.
    Digest::from_content(&serde_json::to_vec(row).unwrap_or_default())
}

/// Returns the key under which the table of one shard is kept.
pub(crate) fn table_key(table: Table, shard: u32) -> Digest {
    let of = json!({"measure": table.name, "version": table.version, "shard": shard});
    Digest::from_content(&canonical_json(&of))
}

impl MeasureTable {
    /// Returns the bytes of the table: for each row its digest, the length of its measure (u32 LE), the measure.
    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        for (digest, measure) in &self.0 {
            bytes.extend_from_slice(digest.as_bytes());
            bytes.extend_from_slice(&(measure.len() as u32).to_le_bytes());
            bytes.extend_from_slice(measure);
        }
        bytes
    }

    /// Reads the bytes of [`MeasureTable::encode`]. None for any other bytes.
    pub(crate) fn decode(bytes: &[u8]) -> Option<Self> {
        let mut rest = bytes.strip_prefix(MAGIC.as_slice())?;
        let mut table = BTreeMap::new();
        while !rest.is_empty() {
            let (digest, tail) = rest.split_first_chunk::<32>()?;
            let (len, tail) = tail.split_first_chunk::<4>()?;
            let (measure, tail) = tail.split_at_checked(u32::from_le_bytes(*len) as usize)?;
            table.insert(Digest::from_bytes(*digest), Arc::from(measure));
            rest = tail;
        }
        Some(Self(table))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_table_survives_its_bytes_and_no_part_of_them(
            rows in prop::collection::btree_map(any::<[u8; 32]>(), prop::collection::vec(any::<u8>(), 0..40), 0..20),
            cut in 0.0_f64..1.0,
        ) {
            let rows = rows.into_iter().map(|(key, value)| (Digest::from_bytes(key), Arc::from(value)));
            let table = MeasureTable(rows.collect());
            let bytes = table.encode();
            prop_assert_eq!(MeasureTable::decode(&bytes), Some(table.clone()));
            let part = &bytes[..(bytes.len() as f64 * cut) as usize];
            prop_assert_ne!(MeasureTable::decode(part), Some(table));
        }
    }

    #[test]
    fn every_part_of_a_row_is_in_its_digest() {
        let row = |id: &str, blob: &[u8], fact: u32| Row {
            id: id.to_owned(),
            blobs: BTreeMap::from([("image".to_owned(), Digest::from_content(blob))]),
            facts: serde_json::json!({ "sol": fact }),
        };
        let base = row_digest(&row("a", b"a", 1));
        assert_eq!(base, row_digest(&row("a", b"a", 1)));
        for other in [row("b", b"a", 1), row("a", b"b", 1), row("a", b"a", 2)] {
            assert_ne!(base, row_digest(&other), "{other:?}");
        }
    }
}
