//! An index of 64-bit hashes by Hamming distance.
//!
//! Multi-index hashing (Norouzi, Punjani and Fleet, CVPR 2012): a hash is four keys of 16 bits, each with a table of
//! buckets. Hashes at most `radius` bits apart differ in some key by at most its share of the radius, so that the buckets
//! of all keys so near are looked through. With few hashes, or a radius for which nearly all buckets are near, all hashes
//! are compared. `benches/fold.rs` measures both, and a BK-tree.

use std::sync::LazyLock;

/// Keys of a hash.
const KEYS: usize = 4;
/// Buckets of a key.
const BUCKETS: usize = 1 << 16;
/// Entries of a block of 128 bytes, two lines of the processor's cache.
const LANES: usize = 12;
/// Blocks that are allocated at once: 512 KB.
const SLAB: usize = 4096;
/// No block.
const NONE: u32 = u32::MAX;
/// Hashes up to which comparing all is faster than looking through buckets.
const FEW: usize = 6_000;
/// Largest radius with tables: at 18 bits 15 % of all entries of a key are looked at, at 22 bits 40 %.
const MAX_RADIUS: u32 = 18;
/// Hashes from which on looking for many at once is faster: fewer are near to few buckets in common.
const MANY: usize = 64;
/// Buckets whose blocks are loaded together.
const BUCKETS_AT_ONCE: usize = 64;
/// Keys may differ by so many bits in the search for the nearest hash: all within 19 bits are then known.
const MAX_KEY_BITS: u32 = 4;

/// All keys by their number of bits, fewest first.
static FLIPS: LazyLock<Vec<u16>> = LazyLock::new(|| {
    let mut flips: Vec<u16> = (0..=u16::MAX).collect();
    flips.sort_by_key(|flip| flip.count_ones());
    flips
});

/// Returns the keys with exactly this number of bits.
fn flips(bits: u32) -> &'static [u16] {
    let from = FLIPS.partition_point(|flip| flip.count_ones() < bits);
    let to = FLIPS.partition_point(|flip| flip.count_ones() <= bits);
    &FLIPS[from..to]
}

/// Returns the keys of a hash: bits k, k + 4, k + 8, … so that neighbouring frequencies are in different keys.
fn keys_of(hash: u64) -> [u16; KEYS] {
    std::array::from_fn(|key| {
        let mut bits = (hash >> key) & 0x1111_1111_1111_1111;
        for (shift, mask) in [
            (3, 0x0303_0303_0303_0303),
            (6, 0x000f_000f_000f_000f),
            (12, 0x0000_00ff_0000_00ff),
            (24, 0xffff),
        ] {
            bits = (bits | (bits >> shift)) & mask;
        }
        bits as u16
    })
}

/// What an index is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Search {
    /// All hashes at most this many bits away.
    Within(u32),
    /// The nearest hashes first.
    Nearest,
}

impl Search {
    /// Returns whether tables are faster than comparing many hashes.
    fn has_tables(self) -> bool {
        match self {
            Self::Within(radius) => radius <= MAX_RADIUS,
            Self::Nearest => true,
        }
    }
}

/// Positions of items by hash. An item may have several hashes.
pub(crate) struct HashIndex {
    search: Search,
    /// All hashes while they are few or tables would not help; else empty.
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

    /// Calls `visit` with the number of each of many hashes and what [`HashIndex::find_within`] finds for it, in any order;
    /// every bucket is looked through once for all. Returns early where `visit` returns false.
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

    /// Calls `accept` with distance and position of hashes, the nearest first, of equals the first position first, until it
    /// returns true or an error; some may come more than once.
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

/// Tables of the keys of an index.
struct Tables {
    /// By key, the number of bits by which keys of hashes within the radius may differ, and the first block of each bucket.
    /// A key that needs no table is left out.
    heads: Vec<(usize, u32, Vec<u32>)>,
    /// Blocks, [`SLAB`] at a time, so that growing copies nothing.
    slabs: Vec<Vec<Block>>,
}

/// Entries of one bucket; all but the first block of a bucket are full.
#[repr(C, align(64))]
struct Block {
    /// The other three keys of each hash.
    others: [[u16; LANES]; KEYS - 1],
    positions: [u32; LANES],
    used: u32,
    next: u32,
}

impl Block {
    /// Returns distance and position of each entry; the keys of the bucket are `bits` apart.
    fn distances(&self, bits: u32, others: &[u16; KEYS - 1]) -> impl Iterator<Item = (u32, u32)> + '_ {
        let mut distances = [bits as u16; LANES];
        for (column, other) in self.others.iter().zip(others) {
            for (distance, value) in distances.iter_mut().zip(column) {
                *distance += ones(value ^ other);
            }
        }
        let entries = distances
            .into_iter()
            .zip(&self.positions)
            .take(self.used as usize);
        entries.map(|(distance, position)| (u32::from(distance), *position))
    }
}

/// By bucket of a key, which of many hashes it is near to.
struct NearBuckets {
    /// Where the hashes of each bucket end, and those of the next begin.
    ends: Vec<u32>,
    hashes: Vec<u32>,
}

impl NearBuckets {
    /// Finds the buckets whose keys differ from that of a hash by at most `most` bits.
    fn of(hashes: &[(u32, u64)], key: usize, most: u32) -> Self {
        let flips = &FLIPS[..FLIPS.partition_point(|flip| flip.count_ones() <= most)];
        let keys: Vec<u16> = hashes.iter().map(|(_, hash)| keys_of(*hash)[key]).collect();
        let mut ends = vec![0_u32; BUCKETS + 1];
        for own in &keys {
            flips
                .iter()
                .for_each(|flip| ends[usize::from(own ^ flip) + 1] += 1);
        }
        for bucket in 0..BUCKETS {
            ends[bucket + 1] += ends[bucket];
        }
        let mut sorted = vec![0; flips.len() * hashes.len()];
        for (hash, own) in (0..).zip(&keys) {
            for flip in flips {
                let end = &mut ends[usize::from(own ^ flip)];
                sorted[*end as usize] = hash;
                *end += 1;
            }
        }
        Self { ends, hashes: sorted }
    }

    /// Returns the hashes that a bucket is near to.
    fn hashes(&self, bucket: usize) -> &[u32] {
        let from = if bucket == 0 { 0 } else { self.ends[bucket - 1] };
        &self.hashes[from as usize..self.ends[bucket] as usize]
    }
}

impl Tables {
    fn new(search: Search) -> Self {
        // The shares plus 1 sum up to the radius plus 1, so that no hash within it exceeds all of them.
        let heads = (0..KEYS).filter_map(|key| {
            let bits = match search {
                Search::Within(radius) => radius.checked_sub(key as u32)? / KEYS as u32,
                Search::Nearest => MAX_KEY_BITS,
            };
            Some((key, bits, vec![NONE; BUCKETS]))
        });
        Self {
            heads: heads.collect(),
            slabs: Vec::new(),
        }
    }

    fn block(&self, at: u32) -> &Block {
        &self.slabs[at as usize / SLAB][at as usize % SLAB]
    }

    fn insert(&mut self, hash: u64, position: u32) {
        let keys = keys_of(hash);
        for (key, _, heads) in &mut self.heads {
            let head = &mut heads[usize::from(keys[*key])];
            let at = *head as usize;
            let block = self.slabs.get_mut(at / SLAB).map(|slab| &mut slab[at % SLAB]);
            let block = match block.filter(|block| (block.used as usize) < LANES) {
                Some(block) => block,
                None => {
                    let next = std::mem::replace(head, add_block(&mut self.slabs));
                    let at = *head as usize;
                    let block = &mut self.slabs[at / SLAB][at % SLAB];
                    block.next = next;
                    block
                }
            };
            let lane = block.used as usize;
            for (others, other) in block.others.iter_mut().zip(others(&keys, *key)) {
                others[lane] = other;
            }
            block.positions[lane] = position;
            block.used += 1;
        }
    }

    fn find_within(&self, hash: u64, radius: u32, mut visit: impl FnMut(u32)) {
        let keys = keys_of(hash);
        for (key, most, heads) in &self.heads {
            for bits in 0..=*most {
                self.scan(
                    heads,
                    keys[*key],
                    bits,
                    &others(&keys, *key),
                    |distance, position| {
                        if distance <= radius {
                            visit(position);
                        }
                    },
                );
            }
        }
    }

    /// As [`HashIndex::find_within_many`].
    fn find_within_many(&self, hashes: &[(u32, u64)], radius: u32, mut visit: impl FnMut(u32, u32) -> bool) {
        for (key, most, heads) in &self.heads {
            let near = NearBuckets::of(hashes, *key, *most);
            let of_key: Vec<_> = hashes.iter().map(|(_, hash)| keys_of(*hash)).collect();
            let of_key: Vec<_> = of_key
                .iter()
                .map(|keys| (keys[*key], others(keys, *key)))
                .collect();
            for first in (0..BUCKETS).step_by(BUCKETS_AT_ONCE) {
                let mut blocks: Vec<(usize, u32)> = (first..first + BUCKETS_AT_ONCE)
                    .filter(|bucket| heads[*bucket] != NONE && !near.hashes(*bucket).is_empty())
                    .map(|bucket| (bucket, heads[bucket]))
                    .collect();
                let mut next = Vec::new();
                while !blocks.is_empty() {
                    self.load(blocks.iter().map(|(_, at)| *at));
                    for (bucket, at) in blocks.drain(..) {
                        let block = self.block(at);
                        for hash in near.hashes(bucket) {
                            let (own, others) = &of_key[*hash as usize];
                            let bits = (own ^ bucket as u16).count_ones();
                            for (distance, position) in block.distances(bits, others) {
                                if distance <= radius && !visit(hashes[*hash as usize].0, position) {
                                    return;
                                }
                            }
                        }
                        if block.next != NONE {
                            next.push((bucket, block.next));
                        }
                    }
                    std::mem::swap(&mut blocks, &mut next);
                }
            }
        }
    }

    /// Appends distance and position of every hash of which some key differs by exactly so many bits.
    fn find_at(&self, hash: u64, bits: u32, found: &mut Vec<(u32, u32)>) {
        let keys = keys_of(hash);
        for (key, _, heads) in &self.heads {
            self.scan(
                heads,
                keys[*key],
                bits,
                &others(&keys, *key),
                |distance, position| {
                    // Farther ones are only reached by comparing all, which starts anew.
                    if distance < KEYS as u32 * (MAX_KEY_BITS + 1) {
                        found.push((distance, position));
                    }
                },
            );
        }
    }

    /// Calls `visit` with distance and position of each entry of the buckets whose keys differ from `key` by so many bits.
    fn scan(
        &self,
        heads: &[u32],
        key: u16,
        bits: u32,
        others: &[u16; KEYS - 1],
        mut visit: impl FnMut(u32, u32),
    ) {
        let blocks = flips(bits).iter().map(|flip| heads[usize::from(key ^ flip)]);
        let mut blocks: Vec<u32> = blocks.filter(|at| *at != NONE).collect();
        let mut next = Vec::new();
        while !blocks.is_empty() {
            self.load(blocks.iter().copied());
            for block in blocks.drain(..).map(|at| self.block(at)) {
                block
                    .distances(bits, others)
                    .for_each(|(distance, position)| visit(distance, position));
                if block.next != NONE {
                    next.push(block.next);
                }
            }
            std::mem::swap(&mut blocks, &mut next);
        }
    }

    /// Reads both lines of blocks, which lie anywhere in memory, so that the processor waits for many at once.
    fn load(&self, blocks: impl Iterator<Item = u32>) {
        let blocks = blocks.map(|at| self.block(at));
        std::hint::black_box(blocks.fold(0, |all, block| all ^ u32::from(block.others[0][0]) ^ block.used));
    }

    fn each(&self, mut visit: impl FnMut(u64, u32)) {
        let Some((key, _, heads)) = self.heads.first() else {
            return;
        };
        for (value, head) in heads.iter().enumerate() {
            let mut at = *head;
            while at != NONE {
                let block = self.block(at);
                for lane in 0..block.used as usize {
                    let others = [0, 1, 2].map(|other: usize| block.others[other][lane]);
                    visit(hash_of(*key, value as u16, &others), block.positions[lane]);
                }
                at = block.next;
            }
        }
    }
}

/// Adds an empty block and returns its number.
fn add_block(slabs: &mut Vec<Vec<Block>>) -> u32 {
    if slabs.last().is_none_or(|slab| slab.len() == SLAB) {
        slabs.push(Vec::with_capacity(SLAB));
    }
    let full = (slabs.len() - 1) * SLAB;
    let Some(slab) = slabs.last_mut() else { return NONE };
    slab.push(Block {
        others: [[0; LANES]; KEYS - 1],
        positions: [0; LANES],
        used: 0,
        next: NONE,
    });
    (full + slab.len() - 1) as u32
}

/// Returns all keys but one, in order.
fn others(keys: &[u16; KEYS], but: usize) -> [u16; KEYS - 1] {
    std::array::from_fn(|at| keys[if at < but { at } else { at + 1 }])
}

/// Returns the number of bits, in steps that are done for many numbers at once.
fn ones(bits: u16) -> u16 {
    let bits = bits - ((bits >> 1) & 0x5555);
    let bits = (bits & 0x3333) + ((bits >> 2) & 0x3333);
    let bits = (bits + (bits >> 4)) & 0x0f0f;
    (bits + (bits >> 8)) & 0x1f
}

/// Returns the hash of one key and the others.
fn hash_of(key: usize, value: u16, others: &[u16; KEYS - 1]) -> u64 {
    let mut hash = 0;
    for at in 0..KEYS {
        let bits = match at.cmp(&key) {
            std::cmp::Ordering::Less => others[at],
            std::cmp::Ordering::Equal => value,
            std::cmp::Ordering::Greater => others[at - 1],
        };
        for bit in 0..16 {
            hash |= u64::from((bits >> bit) & 1) << (4 * bit + at);
        }
    }
    hash
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use proptest::prelude::*;

    use super::*;

    /// Returns hashes, some near those before them.
    fn hashes() -> impl Strategy<Value = Vec<u64>> {
        let drawn = proptest::collection::vec((any::<u64>(), any::<u64>(), 0_u8..5), 1..60);
        drawn.prop_map(|drawn| {
            let mut hashes: Vec<u64> = Vec::new();
            for (hash, flips, kind) in drawn {
                let last = hashes.last().copied().unwrap_or(hash);
                hashes.push(match kind {
                    0 => hash,
                    1 => last,
                    2 => last ^ (1 << (flips % 64)),
                    // A few bits, and many.
                    3 => last ^ (flips & (flips >> 20) & (flips >> 40)),
                    _ => last ^ (flips & (flips >> 13)),
                });
            }
            hashes
        })
    }

    /// An index with tables, however few hashes it has.
    fn with_tables(search: Search, hashes: &[u64]) -> HashIndex {
        let mut tables = Tables::new(search);
        for (position, hash) in (0..).zip(hashes) {
            tables.insert(*hash, position);
        }
        HashIndex {
            search,
            all: Vec::new(),
            tables: Some(tables),
        }
    }

    fn found(index: &HashIndex, hash: u64) -> Vec<u32> {
        let mut found = Vec::new();
        index.find_within(hash, &mut found);
        found.sort_unstable();
        found.dedup();
        found
    }

    /// Returns what is found for each of many hashes at once.
    fn found_together(index: &HashIndex, hashes: &[u64]) -> Vec<Vec<u32>> {
        let numbered: Vec<(u32, u64)> = (0..).zip(hashes.iter().copied()).collect();
        let mut found = vec![Vec::new(); hashes.len()];
        index.find_within_many(&numbered, |number, position| {
            found[number as usize].push(position);
            true
        });
        for positions in &mut found {
            positions.sort_unstable();
            positions.dedup();
        }
        found
    }

    fn scanned(hashes: &[u64], hash: u64, radius: u32) -> Vec<u32> {
        let near = (0..)
            .zip(hashes)
            .filter(|(_, other)| (hash ^ **other).count_ones() <= radius);
        near.map(|(position, _)| position).collect()
    }

    /// Returns the first hash that is accepted, and how far it is.
    fn nearest(index: &HashIndex, hash: u64, accept: impl Fn(u32) -> bool) -> Option<(u32, u32)> {
        let mut found = None;
        let asked: Result<(), Infallible> = index.find_nearest(hash, |distance, position| {
            found = accept(position).then_some((distance, position));
            Ok(found.is_some())
        });
        asked.unwrap();
        found
    }

    proptest! {
        #[test]
        fn tables_find_what_comparing_all_finds(hashes in hashes(), radius in prop_oneof![Just(0), Just(1), Just(3), Just(14), Just(18), Just(64), 0_u32..20]) {
            let index = with_tables(Search::Within(radius), &hashes);
            let mut growing = HashIndex::new(Search::Within(radius));
            for (position, hash) in (0..).zip(&hashes) {
                growing.insert(*hash, position);
            }
            for hash in &hashes {
                let expected = scanned(&hashes, *hash, radius);
                prop_assert_eq!(&found(&growing, *hash), &expected);
                if radius <= MAX_RADIUS {
                    prop_assert_eq!(&found(&index, *hash), &expected);
                }
            }
        }

        #[test]
        fn the_nearest_is_the_nearest_and_of_equals_the_first(hashes in hashes(), hash in any::<u64>(), skip in 1_u32..4) {
            let accept = |position: u32| position.is_multiple_of(skip);
            let mut growing = HashIndex::new(Search::Nearest);
            for (position, hash) in (0..).zip(&hashes) {
                growing.insert(*hash, position);
            }
            let tables = with_tables(Search::Nearest, &hashes);
            for hash in hashes.iter().copied().chain([hash]) {
                let all = (0_u32..).zip(&hashes).filter(|(position, _)| accept(*position));
                let expected = all.map(|(position, other)| ((hash ^ other).count_ones(), position)).min();
                prop_assert_eq!(nearest(&growing, hash, accept), expected);
                prop_assert_eq!(nearest(&tables, hash, accept), expected);
            }
            prop_assert_eq!(nearest(&tables, hash, |_| false), None);
        }

        #[test]
        fn keys_hold_every_bit_once(hash in any::<u64>()) {
            let keys = keys_of(hash);
            prop_assert_eq!(keys.iter().map(|key| key.count_ones()).sum::<u32>(), hash.count_ones());
            for key in 0..KEYS {
                prop_assert_eq!(hash_of(key, keys[key], &others(&keys, key)), hash);
                prop_assert_eq!(u32::from(ones(keys[key])), keys[key].count_ones());
            }
        }
    }

    /// 500 hashes within 12 bits of one another, among as many as make the index change from comparing all to tables.
    #[test]
    fn a_cluster_of_500_is_found_whole_before_and_after_tables_are_made() {
        let mut state = 7_u64;
        let mut draw = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            state ^ (state >> 29)
        };
        let centre = draw();
        let mut hashes: Vec<u64> = Vec::new();
        while hashes.len() < FEW + 2_000 {
            let near = (0..6).fold(centre, |hash, _| hash ^ (1 << (draw() >> 58)));
            hashes.push(if hashes.len().is_multiple_of(16) { near } else { draw() });
        }
        for radius in [0, 14, 64] {
            let mut index = HashIndex::new(Search::Within(radius));
            for (position, hash) in (0..).zip(&hashes) {
                index.insert(*hash, position);
                if [100, FEW as u32 - 1, FEW as u32 + 1, hashes.len() as u32 - 1].contains(&position) {
                    let inserted = &hashes[..=position as usize];
                    assert_eq!(
                        found(&index, centre),
                        scanned(inserted, centre, radius),
                        "{radius} {position}"
                    );
                }
            }
            assert_eq!(index.tables.is_some(), radius <= MAX_RADIUS);
            let asked = &hashes[..MANY + 30];
            let expected: Vec<_> = asked.iter().map(|hash| scanned(&hashes, *hash, radius)).collect();
            assert_eq!(found_together(&index, asked), expected, "{radius}");
            let mut left = 3;
            index.find_within_many(&(0..).zip(asked.iter().copied()).collect::<Vec<_>>(), |_, _| {
                left -= 1;
                left > 0
            });
            assert_eq!(left, 0, "it goes on after it was told to stop");
        }
    }
}
