//! Tables of rows kept from run to run.

use std::collections::BTreeMap;

use marf_cache::Digest;
use marf_stage::Ctx;

const MAGIC: &[u8; 8] = b"marftab1";

/// Rows kept from run to run under one memo key; losing a table costs only time.
#[derive(Debug, Default, Clone, PartialEq)]
pub(super) struct MemoTable {
    rows: BTreeMap<[u8; 32], Vec<u8>>,
}

impl MemoTable {
    /// Reads the table of an earlier run; empty if it cannot be read.
    pub(super) fn load(ctx: &Ctx<'_>, key: &Digest) -> Self {
        let kept = ctx.memos.load(key);
        kept.and_then(|bytes| Self::decode(&bytes)).unwrap_or_default()
    }

    /// Writes the table.
    pub(super) fn save(&self, ctx: &Ctx<'_>, key: &Digest) {
        ctx.memos.save(key, &self.encode());
    }

    /// Returns a row.
    pub(super) fn get(&self, key: &Digest) -> Option<&[u8]> {
        self.rows.get(key.as_bytes()).map(Vec::as_slice)
    }

    /// Adds or replaces a row.
    pub(super) fn insert(&mut self, key: &Digest, row: Vec<u8>) {
        self.rows.insert(*key.as_bytes(), row);
    }

    fn encode(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        for (key, row) in &self.rows {
            bytes.extend(key);
            bytes.extend((row.len() as u32).to_le_bytes());
            bytes.extend(row);
        }
        bytes
    }

    fn decode(bytes: &[u8]) -> Option<Self> {
        let mut rest = bytes.strip_prefix(MAGIC)?;
        let mut table = Self::default();
        while let Some((key, after)) = rest.split_first_chunk::<32>() {
            let (len, after) = after.split_first_chunk::<4>()?;
            let (row, after) = after.split_at_checked(u32::from_le_bytes(*len) as usize)?;
            table.rows.insert(*key, row.to_vec());
            rest = after;
        }
        rest.is_empty().then_some(table)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_comes_back_and_a_torn_one_does_not() {
        let mut table = MemoTable::default();
        for text in ["", "a", "longer"] {
            table.insert(&Digest::of(text.as_bytes()), text.as_bytes().to_vec());
        }
        let bytes = table.encode();
        assert_eq!(MemoTable::decode(&bytes).as_ref(), Some(&table));
        assert_eq!(MemoTable::decode(&bytes[..bytes.len() - 1]), None);
        assert_eq!(MemoTable::decode(b"other"), None);
    }
}
