//! An index of 64-bit hashes by Hamming distance.
//!
//! Multi-index hashing (Norouzi, Punjani and Fleet, CVPR 2012): a hash is four keys of 16 bits, each with a table of
//! buckets. Hashes at most `radius` bits apart differ in some key by at most its share of the radius, so that the buckets
//! of all keys so near are looked through. With few hashes, or a radius for which nearly all buckets are near, all hashes
//! are compared. `benches/fold.rs` measures both, and a BK-tree.

mod tables;
#[cfg(test)]
mod tests;

pub(crate) use tables::Search;
use tables::{KEYS, MANY, MAX_KEY_BITS, Tables};

/// Hashes up to which comparing all is faster than looking through buckets.
const FEW: usize = 12_000;

/// Positions of items by hash. An item may have several hashes.
pub(crate) struct HashIndex {
    search: Search,
    /// All hashes while they are few or tables would not help, otherwise empty.
    all: Vec<(u64, u32)>,
    tables: Option<Tables>,
}

impl HashIndex {
    /// Returns an empty index.
    pub(crate) fn new(search: Search) -> Self {
        Self {
            search,
            all: Vec::new(),
            tables: None,
        }
    }

    /// Adds a hash of the item at a position.
    pub(crate) fn insert(&mut self, hash: u64, position: u32) {
        if let Some(tables) = &mut self.tables {
            tables.insert(hash, position);
            return;
        }
        self.all.push((hash, position));
        if self.all.len() > FEW && self.search.has_tables() {
            let mut tables = Tables::new(self.search);
            for (hash, position) in std::mem::take(&mut self.all) {
                tables.insert(hash, position);
            }
            self.tables = Some(tables);
        }
    }

    /// Appends the positions of all hashes within the radius of [`Search::Within`], some more than once.
    pub(crate) fn find_within(&self, hash: u64, found: &mut Vec<u32>) {
        let Search::Within(radius) = self.search else {
            return;
        };
        match &self.tables {
            Some(tables) => tables.find_within(hash, radius, |position| found.push(position)),
            None => {
                let near = self
                    .all
                    .iter()
                    .filter(|(other, _)| (hash ^ other).count_ones() <= radius);
                found.extend(near.map(|(_, position)| *position));
            }
        }
    }

    /// Calls `visit` with the number of each of many hashes and each result of [`HashIndex::find_within`] for it, in
    /// any order. Every bucket is searched once for all. Returns early if `visit` returns false.
    pub(crate) fn find_within_many(&self, hashes: &[(u32, u64)], mut visit: impl FnMut(u32, u32) -> bool) {
        match (&self.tables, self.search) {
            (Some(tables), Search::Within(radius)) if hashes.len() >= MANY => {
                tables.find_within_many(hashes, radius, visit);
            }
            _ => {
                for (number, hash) in hashes {
                    let mut found = Vec::new();
                    self.find_within(*hash, &mut found);
                    if !found.into_iter().all(|position| visit(*number, position)) {
                        return;
                    }
                }
            }
        }
    }

    /// Calls `accept` with distance and position of hashes, the nearest first, ties by position, until it returns
    /// true or an error. Some may come more than once.
    ///
    /// # Errors
    /// The error of `accept`.
    pub(crate) fn find_nearest<E>(
        &self,
        hash: u64,
        mut accept: impl FnMut(u32, u32) -> Result<bool, E>,
    ) -> Result<(), E> {
        let mut found = Vec::new();
        if let Some(tables) = &self.tables {
            for bits in 0..=MAX_KEY_BITS {
                tables.find_at(hash, bits, &mut found);
                // Whatever is nearer than this differs in some key by no more than `bits`.
                let known = KEYS as u32 * (bits + 1);
                found.sort_unstable();
                let (near, far) = found.split_at(found.partition_point(|(distance, _)| *distance < known));
                for (distance, position) in near {
                    if accept(*distance, *position)? {
                        return Ok(());
                    }
                }
                found = far.to_vec();
            }
        }
        found.clear();
        self.each(|other, position| found.push(((hash ^ other).count_ones(), position)));
        // One distance after the other: the first is enough nearly always.
        for distance in 0..=u64::BITS {
            let near = found.iter().filter(|(other, _)| *other == distance);
            let mut positions: Vec<u32> = near.map(|(_, position)| *position).collect();
            positions.sort_unstable();
            for position in positions {
                if accept(distance, position)? {
                    return Ok(());
                }
            }
        }
        Ok(())
    }

    /// Calls `visit` with every hash and its position.
    fn each(&self, mut visit: impl FnMut(u64, u32)) {
        match &self.tables {
            Some(tables) => tables.each(visit),
            None => self
                .all
                .iter()
                .for_each(|(hash, position)| visit(*hash, *position)),
        }
    }
}
