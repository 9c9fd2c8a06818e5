//! What merges, repairs and collections change in the index.

use std::collections::BTreeSet;

use rusqlite::{Connection, TransactionBehavior};

use super::{Index, PackRewrite, connection::Trouble, tables};
use crate::{
    Digest,
    store::{
        error::StoreError,
        pack::{Entry, Kind},
    },
};

impl Index {
    /// Registers that packs were joined into another. Returns whether the index has it. If not, the new pack is
    /// useless.
    pub(in crate::store) fn join(&self, into: &str, moved: &[(String, u64)]) -> Result<bool, StoreError> {
        self.change(|connection| tables::join(connection, into, moved))
    }

    /// Registers that the objects of a pack have moved to another pack, and drops the first.
    pub(in crate::store) fn rewrite(
        &self,
        from: &str,
        into: &str,
        entries: &[Entry],
    ) -> Result<bool, StoreError> {
        self.change(|connection| tables::rewrite(connection, from, into, entries))
    }

    /// Registers the new places of the objects of some packs, and drops these packs. Returns whether the index
    /// took it.
    pub(in crate::store) fn compact(&self, packs: &[PackRewrite]) -> Result<bool, StoreError> {
        self.change(|connection| tables::compact(connection, packs))
    }

    /// Drops packs with all their rows.
    pub(in crate::store) fn forget(&self, files: &BTreeSet<String>) -> Result<bool, StoreError> {
        self.change(|connection| tables::forget(connection, files))
    }

    /// Drops the rows of objects.
    pub(in crate::store) fn remove(&self, objects: &[(Kind, Digest)]) -> Result<bool, StoreError> {
        self.change(|connection| {
            let mut objects = objects.iter();
            objects.try_for_each(|(kind, id)| tables::remove(connection, *kind, id))
        })
    }

    /// Makes a change in one transaction. Returns whether it was made.
    fn change(&self, change: impl Fn(&Connection) -> rusqlite::Result<()>) -> Result<bool, StoreError> {
        // Rows in memory would name packs that are about to change: they go into the file first.
        if self.memory.lock().is_some() {
            self.refresh(self.patience())?;
        }
        if self.memory.lock().is_some() {
            return Ok(false);
        }
        self.write(self.patience(), |connection| {
            let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            match change(&transaction) {
                Err(rusqlite::Error::QueryReturnedNoRows) => {
                    Err(Trouble::Unusable("packs changed at the same time".to_owned()))
                }
                other => {
                    other?;
                    Ok(transaction.commit()?)
                }
            }
        })
    }
}
