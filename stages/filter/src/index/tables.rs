//! Buckets of hashes by their keys, in blocks that fill two lines of the processor's cache.

use std::sync::LazyLock;

/// Keys of a hash.
pub(super) const KEYS: usize = 4;
/// Buckets of a key.
const BUCKETS: usize = 1 << 16;
/// Entries of a block of 128 bytes, two lines of the processor's cache.
const LANES: usize = 12;
/// Blocks that are allocated at once: 512 KB.
const SLAB: usize = 4096;
/// No block.
const NONE: u32 = u32::MAX;
/// Buckets whose blocks are loaded together.
const BUCKETS_AT_ONCE: usize = 64;
/// Most bits by which keys may differ in the search for the nearest hash: all within 19 bits are then known.
pub(super) const MAX_KEY_BITS: u32 = 4;
/// Hashes from which on looking for many at once is faster: fewer are near to few buckets in common.
pub(super) const MANY: usize = 64;

/// Largest radius with tables: at 18 bits 15 % of all entries of a key are looked at, at 22 bits 40 %.
pub(super) const MAX_RADIUS: u32 = 18;

/// What an index is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Search {
    /// All hashes at most this many bits away.
    Within(u32),
    /// The nearest hashes first.
    Nearest,
}

impl Search {
    /// Whether tables are faster than comparing many hashes.
    pub(super) fn has_tables(self) -> bool {
        match self {
            Self::Within(radius) => radius <= MAX_RADIUS,
            Self::Nearest => true,
        }
    }
}

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
pub(super) fn keys_of(hash: u64) -> [u16; KEYS] {
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

/// The buckets of one key.
struct KeyTable {
    key: usize,
    /// Bits by which keys of hashes within the radius may differ.
    most_bits: u32,
    /// The first block of each bucket.
    heads: Vec<u32>,
}

/// Tables of the keys of an index.
pub(super) struct Tables {
    /// The tables of the keys. A key that needs none is left out.
    keys: Vec<KeyTable>,
    /// Blocks, [`SLAB`] at a time, so that growing copies nothing.
    slabs: Vec<Vec<Block>>,
}

/// Entries of one bucket. All but the first block of a bucket are full.
#[repr(C, align(64))]
struct Block {
    /// The other three keys of each hash.
    others: [[u16; LANES]; KEYS - 1],
    positions: [u32; LANES],
    used: u32,
    next: u32,
}

impl Block {
    /// Returns distance and position of the entries at most `radius` bits away. The keys of the bucket are `bits`
    /// apart.
    #[inline]
    fn within(
        &self,
        bits: u32,
        others: &[u16; KEYS - 1],
        radius: u32,
    ) -> impl Iterator<Item = (u32, u32)> + '_ {
        let mut distances = [0_i16; LANES];
        for (column, other) in self.others.iter().zip(others) {
            for (sum, word) in distances.iter_mut().zip(column) {
                *sum = sum.wrapping_add(ones_by_four(word ^ other) as i16);
            }
        }
        distances.iter_mut().for_each(|sum| *sum = sum_of_fours(*sum));
        // Nearly always no entry is near, which one test shows for all lanes at once.
        let least = distances
            .iter()
            .fold(i16::MAX, |least, distance| least.min(*distance));
        let used = if least as u32 + bits <= radius {
            self.used as usize
        } else {
            0
        };
        let entries = distances.into_iter().zip(&self.positions).take(used);
        let entries = entries.map(move |(distance, position)| (distance as u32 + bits, *position));
        entries.filter(move |(distance, _)| *distance <= radius)
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
    fn new(hashes: &[(u32, u64)], key: usize, most: u32) -> Self {
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
    pub(super) fn new(search: Search) -> Self {
        // The shares plus 1 sum up to the radius plus 1, so that no hash within it exceeds all of them.
        let tables = (0..KEYS).filter_map(|key| {
            let most_bits = match search {
                Search::Within(radius) => radius.checked_sub(key as u32)? / KEYS as u32,
                Search::Nearest => MAX_KEY_BITS,
            };
            let heads = vec![NONE; BUCKETS];
            Some(KeyTable {
                key,
                most_bits,
                heads,
            })
        });
        Self {
            keys: tables.collect(),
            slabs: Vec::new(),
        }
    }

    fn block(&self, at: u32) -> &Block {
        &self.slabs[at as usize / SLAB][at as usize % SLAB]
    }

    pub(super) fn insert(&mut self, hash: u64, position: u32) {
        let keys = keys_of(hash);
        for table in &mut self.keys {
            let head = &mut table.heads[usize::from(keys[table.key])];
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
            for (others, other) in block.others.iter_mut().zip(others(&keys, table.key)) {
                others[lane] = other;
            }
            block.positions[lane] = position;
            block.used += 1;
        }
    }

    pub(super) fn find_within(&self, hash: u64, radius: u32, mut visit: impl FnMut(u32)) {
        let keys = keys_of(hash);
        for table in &self.keys {
            for bits in 0..=table.most_bits {
                self.scan(table, &keys, bits, radius, |_, position| visit(position));
            }
        }
    }

    /// As [`HashIndex::find_within_many`].
    pub(super) fn find_within_many(
        &self,
        hashes: &[(u32, u64)],
        radius: u32,
        mut visit: impl FnMut(u32, u32) -> bool,
    ) {
        for table in &self.keys {
            let (key, heads) = (table.key, &table.heads);
            let near = NearBuckets::new(hashes, key, table.most_bits);
            let keys = hashes.iter().map(|(_, hash)| keys_of(*hash));
            let of_key: Vec<_> = keys.map(|keys| (keys[key], others(&keys, key))).collect();
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
                            let mut near = block.within(bits, others, radius);
                            if !near.all(|(_, position)| visit(hashes[*hash as usize].0, position)) {
                                return;
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

    /// Appends distance and position of every hash with a key that differs by exactly `bits` bits.
    pub(super) fn find_at(&self, hash: u64, bits: u32, found: &mut Vec<(u32, u32)>) {
        let keys = keys_of(hash);
        // Farther ones are only reached by comparing all, which starts again.
        let radius = KEYS as u32 * (MAX_KEY_BITS + 1) - 1;
        for table in &self.keys {
            self.scan(table, &keys, bits, radius, |distance, position| {
                found.push((distance, position));
            });
        }
    }

    /// Calls `visit` with distance and position of each entry within the radius. Searches the buckets of a table
    /// whose key differs from that of a hash by exactly `bits` bits. `keys` are those of the hash.
    fn scan(
        &self,
        table: &KeyTable,
        keys: &[u16; KEYS],
        bits: u32,
        radius: u32,
        mut visit: impl FnMut(u32, u32),
    ) {
        let (own, others) = (keys[table.key], others(keys, table.key));
        let blocks = flips(bits)
            .iter()
            .map(|flip| table.heads[usize::from(own ^ flip)]);
        let mut blocks: Vec<u32> = blocks.filter(|at| *at != NONE).collect();
        let mut next = Vec::new();
        while !blocks.is_empty() {
            self.load(blocks.iter().copied());
            for block in blocks.drain(..).map(|at| self.block(at)) {
                let near = block.within(bits, &others, radius);
                near.for_each(|(distance, position)| visit(distance, position));
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

    pub(super) fn each(&self, mut visit: impl FnMut(u64, u32)) {
        let Some(table) = self.keys.first() else {
            return;
        };
        for (value, head) in table.heads.iter().enumerate() {
            let mut at = *head;
            while at != NONE {
                let block = self.block(at);
                for lane in 0..block.used as usize {
                    let others = [0, 1, 2].map(|other: usize| block.others[other][lane]);
                    visit(hash_of(table.key, value as u16, &others), block.positions[lane]);
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
pub(super) fn others(keys: &[u16; KEYS], but: usize) -> [u16; KEYS - 1] {
    std::array::from_fn(|at| keys[if at < but { at } else { at + 1 }])
}

/// Returns the number of bits of each four bits of a word. Its steps, as those of [`sum_of_fours`], are done for many words at
/// once.
#[inline]
pub(super) fn ones_by_four(word: u16) -> u16 {
    let by_two = word - ((word >> 1) & 0x5555);
    (by_two & 0x3333) + ((by_two >> 2) & 0x3333)
}

/// Returns the sum of the numbers of four bits in a word: up to 12 each, of three words.
#[inline]
pub(super) fn sum_of_fours(word: i16) -> i16 {
    let by_eight = (word & 0x0f0f) + ((word >> 4) & 0x0f0f);
    (by_eight + (by_eight >> 8)) & 0xff
}

/// Returns the hash of one key and the others.
pub(super) fn hash_of(key: usize, value: u16, others: &[u16; KEYS - 1]) -> u64 {
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
