//! A damaged index: rebuilt from the packs, or disabled.

use std::sync::atomic::Ordering;

use super::{
    super::{
        error::StoreError,
        files::Access,
        locks::{Lock, Share},
    },
    Index,
    connection::{FileId, Trouble},
};

impl Index {
    /// Returns a fault of the form of the file, or `None` if it is valid. The rows are not checked.
    pub(in super::super) fn fault(&self) -> Option<String> {
        if self.access == Access::ReadOnly {
            return None;
        }
        let verdict = self.with_connection(&self.reader, |connection| {
            connection.query_row("PRAGMA integrity_check(1)", [], |row| row.get::<_, String>(0))
        });
        match verdict {
            Ok(verdict) => (verdict != "ok").then_some(verdict),
            Err(Trouble::Broken(message)) => Some(message),
            Err(Trouble::Busy | Trouble::Unusable(_)) => None,
        }
    }

    /// Rebuilds the file from the packs, and moves the old one to `bad/`.
    pub(in super::super) fn rebuild(&self, why: &str) -> Result<(), StoreError> {
        if self.access == Access::ReadOnly {
            return self.disable(why);
        }
        let used = FileId::from_path(&self.path);
        // Closed before the file moves: the last connection to a file removes its log.
        let broken = [self.reader.lock().take(), self.writer.lock().take()];
        let guard = self.locks.take(Lock::Index, Share::Exclusive, &self.notices)?;
        drop(broken);
        if FileId::from_path(&self.path) != used {
            return Ok(());
        }
        self.notices.warn(format!(
            "the index `{}` was damaged ({why}) and is rebuilt from the packs",
            self.path.display()
        ));
        let moved = self.move_away();
        let made = moved.map_err(|error| Trouble::Unusable(error.to_string()));
        let made = made.and_then(|()| self.create());
        drop(guard);
        match made {
            Ok(handle) => {
                *self.reader.lock() = Some(handle);
                self.memory.lock().take();
                Ok(())
            }
            Err(Trouble::Busy) => Ok(()),
            Err(Trouble::Broken(message) | Trouble::Unusable(message)) => self.disable(&message),
        }
    }

    fn move_away(&self) -> Result<(), StoreError> {
        if self.path.exists() {
            self.files.quarantine(&self.root, &self.path, "index.sqlite")?;
        }
        for suffix in ["-wal", "-shm"] {
            let path = self.beside(suffix);
            if path.exists() {
                self.files
                    .quarantine(&self.root, &path, &format!("index.sqlite{suffix}"))?;
            }
        }
        Ok(())
    }

    /// Gives the file up: all packs are registered in memory.
    pub(super) fn disable(&self, why: &str) -> Result<(), StoreError> {
        if self.is_disabled.swap(true, Ordering::Relaxed) {
            return Ok(());
        }
        if self.access == Access::ReadWrite {
            self.notices.warn(format!(
                "the index `{}` cannot be used ({why}). The packs are read instead",
                self.path.display()
            ));
        }
        for file in self.listed()? {
            if let Some(entries) = self.entries(&file)? {
                self.remember(&file, &entries);
            }
        }
        Ok(())
    }
}
