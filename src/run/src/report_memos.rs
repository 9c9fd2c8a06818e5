//! What reports remember of sets of photos and of pictures.

use std::sync::Arc;

use marf_cache::{Digest, Store};
use marf_stage::Memos;

/// Memos in the store, and the key they are kept for. Without a key they are only read. A lost memo only costs time.
pub struct StoreMemos<'a>(pub &'a Store, pub Option<Digest>);

impl Memos for StoreMemos<'_> {
    fn load(&self, key: &Digest) -> Option<Arc<[u8]>> {
        let blob = self.0.memo(key).ok()??;
        self.0.get(&blob).ok()
    }

    fn save(&self, key: &Digest, table: &[u8]) {
        let stored = self.1.and_then(|maker| Some((maker, self.0.put(table).ok()?)));
        if let Some((maker, blob)) = stored {
            self.0.put_memo(*key, blob, maker);
        }
    }
}
