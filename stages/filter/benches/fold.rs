//! How near duplicates are found among many photos: the index on hashes against a BK-tree and against comparing all, and
//! the fold of `duplicate` over sols of 1,000 photos.
//!
//! usage: cargo bench -p marf-filter --bench fold [-- index | fold [PHOTOS...]]. Default: all, 10,000 to 1,000,000
//! photos. The hashes are synthetic: 70 % drawn, 30 % in clusters of up to 500 within 6 bits of a centre, spread over
//! all sols. The planes of a cluster differ by noise, so that its photos are duplicates of the first one. Nothing is
//! written to disk: descriptors and planes are generated on request.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a bench that a person runs"
)]
#![allow(
    dead_code,
    unused_imports,
    reason = "the index is taken as it is, and not all of it is measured"
)]

use std::collections::BTreeMap;
use std::hint::black_box;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::{fs, time::Instant};

use index::{HashIndex, Search};
use marf_cache::{Digest, manifest::Row};
use marf_filter::STAGES;
use marf_stage::{BlobError, Blobs, Ctx, FoldState, Measured, Work, harness::Harness};

#[path = "../src/index/mod.rs"]
mod index;

/// Photos of a sol.
const SOL: usize = 1000;
/// Largest distance of candidates, bits: the default of `duplicate`.
const RADIUS: u32 = 14;

fn main() {
    let words: Vec<String> = std::env::args()
        .skip(1)
        .filter(|word| !word.starts_with("--"))
        .collect();
    let numbers: Vec<usize> = words.iter().filter_map(|word| word.parse().ok()).collect();
    let counts = if numbers.is_empty() {
        vec![10_000, 100_000, 1_000_000]
    } else {
        numbers
    };
    let wants = |what: &str| {
        words
            .iter()
            .all(|word| word.parse::<usize>().is_ok() || word == what)
    };
    if wants("index") {
        counts.iter().for_each(|count| compare_indexes(*count));
    }
    if wants("fold") {
        counts.iter().for_each(|count| fold(*count));
    }
}

/// Returns a number that follows from another as at random (splitmix64).
fn mixed(seed: u64) -> u64 {
    let z = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Returns the cluster of a photo: itself, or one of those that 30 % of the photos are in, 1 to 500 photos each.
fn cluster(photo: usize, photos: usize) -> u64 {
    let drawn = mixed(photo as u64);
    if drawn % 10 < 7 {
        return photo as u64;
    }
    // Cubed, so that most clusters are small: the largest has some 500.
    let clusters = (photos * 3 / 10 / 60).max(1) as f64;
    let part = (mixed(drawn) >> 11) as f64 / (1_u64 << 53) as f64;
    u64::MAX - (clusters * part * part.sqrt()) as u64
}

/// Returns the hash of a photo: up to 6 bits from that of its cluster.
fn hash_of(photo: usize, photos: usize) -> u64 {
    let cluster = cluster(photo, photos);
    let centre = mixed(cluster);
    if cluster == photo as u64 {
        return centre;
    }
    (0..3).fold(centre, |hash, at| {
        hash ^ (1 << (mixed(3 * photo as u64 + at) >> 58))
    })
}

/// CPU seconds of this thread, or wall time if the system does not report them.
struct Clock {
    wall: Instant,
    on_core_ns: Option<u64>,
}

impl Clock {
    fn now() -> Self {
        Self {
            wall: Instant::now(),
            on_core_ns: on_core_ns(),
        }
    }

    fn seconds(&self) -> f64 {
        match self.on_core_ns.zip(on_core_ns()) {
            Some((from, to)) => (to - from) as f64 * 1e-9,
            None => self.wall.elapsed().as_secs_f64(),
        }
    }
}

fn on_core_ns() -> Option<u64> {
    let text = fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split_whitespace().next()?.parse().ok()
}

/// Returns the resident memory of the process in megabytes, 0 if the system does not report it.
fn resident_mb() -> f64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok());
    kilobytes.unwrap_or(0.0) / 1024.0
}

/// A BK-tree: below a hash, by distance from it, the hashes at that distance.
#[derive(Default)]
struct BkTree(Vec<(u64, BTreeMap<u32, u32>)>);

impl BkTree {
    fn insert(&mut self, hash: u64) {
        let added = self.0.len() as u32;
        let mut at = 0;
        while let Some((own, below)) = self.0.get_mut(at) {
            match below.entry((*own ^ hash).count_ones()) {
                std::collections::btree_map::Entry::Occupied(next) => at = *next.get() as usize,
                std::collections::btree_map::Entry::Vacant(free) => {
                    free.insert(added);
                    break;
                }
            }
        }
        self.0.push((hash, BTreeMap::new()));
    }

    fn find_within(&self, hash: u64, found: &mut Vec<u32>) {
        let mut open = vec![0_u32];
        while let Some(at) = open.pop() {
            let (own, below) = &self.0[at as usize];
            let distance = (own ^ hash).count_ones();
            if distance <= RADIUS {
                found.push(at);
            }
            open.extend(
                below
                    .range(distance.saturating_sub(RADIUS)..=distance + RADIUS)
                    .map(|(_, next)| *next),
            );
        }
    }
}

fn compare_indexes(photos: usize) {
    let hashes: Vec<u64> = (0..photos).map(|photo| hash_of(photo, photos)).collect();
    let before = resident_mb();
    let clock = Clock::now();
    let mut index = HashIndex::new(Search::Within(RADIUS));
    (0..)
        .zip(&hashes)
        .for_each(|(position, hash)| index.insert(*hash, position));
    let inserting = clock.seconds();
    let bytes = (resident_mb() - before) * 1024.0 * 1024.0 / photos as f64;
    let mut tree = BkTree::default();
    hashes.iter().for_each(|hash| tree.insert(*hash));
    let queries = 200;
    let asked = |find: &dyn Fn(u64, &mut Vec<u32>)| {
        let clock = Clock::now();
        let mut total = 0;
        for query in 0..queries {
            let mut found = Vec::new();
            find(hash_of(query * (photos / queries), photos), &mut found);
            found.sort_unstable();
            found.dedup();
            total += found.len();
        }
        (clock.seconds() * 1e6 / queries as f64, total)
    };
    let by_index = asked(&|hash, found| index.find_within(hash, found));
    let many: Vec<(u32, u64)> = (0..SOL as u32)
        .map(|query| (query, hash_of(query as usize * (photos / SOL), photos)))
        .collect();
    let clock = Clock::now();
    index.find_within_many(&many, |number, position| black_box(number ^ position) != u32::MAX);
    let together = clock.seconds() * 1e6 / SOL as f64;
    let by_tree = asked(&|hash, found| tree.find_within(hash, found));
    let by_all = asked(&|hash, found| {
        let near = (0..)
            .zip(&hashes)
            .filter(|(_, other)| (hash ^ **other).count_ones() <= RADIUS);
        found.extend(near.map(|(position, _)| position));
    });
    assert!(
        by_index.1 == by_all.1 && by_tree.1 == by_all.1,
        "{by_index:?} {by_tree:?} {by_all:?}"
    );
    println!(
        "{photos} hashes, within {RADIUS} bits, us a query: index {:.1}, of 1,000 at once {together:.1}, BK-tree {:.1}, all {:.1}; {} found; index: {:.2} us an \
         insertion, {bytes:.0} bytes a hash",
        by_index.0,
        by_tree.0,
        by_all.0,
        by_all.1,
        inserting * 1e6 / photos as f64,
    );
}

/// A store that generates the planes of a photo from their digest and keeps written blobs.
struct Store {
    put: Mutex<BTreeMap<Digest, Arc<[u8]>>>,
    planes_read: Mutex<u64>,
}

impl Store {
    /// Returns the digest that identifies the planes of a photo.
    fn planes_digest(photo: usize, cluster: u64) -> Digest {
        let mut bytes = [0; 32];
        bytes[..8].copy_from_slice(&(photo as u64).to_le_bytes());
        bytes[8..16].copy_from_slice(&cluster.to_le_bytes());
        bytes[16..].fill(0xee);
        Digest::from_bytes(bytes)
    }
}

impl Blobs for Store {
    fn get(&self, digest: &Digest) -> Result<Arc<[u8]>, BlobError> {
        if let Some(bytes) = self.put.lock().unwrap().get(digest) {
            return Ok(Arc::clone(bytes));
        }
        *self.planes_read.lock().unwrap() += 1;
        let bytes = digest.as_bytes();
        let number = |from: usize| u64::from_le_bytes(bytes[from..from + 8].try_into().unwrap());
        let (photo, cluster) = (number(0), number(8));
        let cells = (0..4096_u64).step_by(8).flat_map(|at| {
            let noise = mixed(photo.wrapping_mul(4096) + at) & 0x0303_0303_0303_0303;
            (mixed(cluster.wrapping_mul(4096) + at) & 0x7f7f_7f7f_7f7f_7f7f)
                .wrapping_add(noise)
                .to_le_bytes()
        });
        Ok(cells.collect())
    }

    fn put(&self, bytes: &[u8]) -> Result<Digest, BlobError> {
        let digest = Digest::from_content(bytes);
        self.put.lock().unwrap().insert(digest, Arc::from(bytes));
        Ok(digest)
    }

    fn put_file(&self, path: &Path, _: u64, _: marf_stage::Keep) -> Result<(Digest, Arc<[u8]>), BlobError> {
        unreachable!("no stage of this bench stores `{}`", path.display())
    }

    fn contains(&self, _: &Digest) -> bool {
        true
    }

    fn commit(&self) -> Result<(), BlobError> {
        Ok(())
    }
}

/// Returns a photo as a row and as its measure, which has a first byte 1, then size, sharpness, colour, hashes behind their
/// number, and the digest of the planes.
fn photo(photo: usize, photos: usize) -> (Row, Vec<u8>) {
    let row = Row {
        id: format!("NLF_{photo:07}_0671382174_448ECM"),
        blobs: BTreeMap::new(),
        facts: serde_json::json!({"file": "", "width": 1280, "height": 960, "sol": photo / SOL}),
    };
    let mut measure = vec![1];
    measure.extend(1280_u32.to_le_bytes());
    measure.extend(960_u32.to_le_bytes());
    measure.extend((mixed(!photo as u64) as f64).to_le_bytes());
    measure.extend(0.1_f64.to_le_bytes());
    measure.push(1);
    measure.extend(hash_of(photo, photos).to_le_bytes());
    measure.extend(Store::planes_digest(photo, cluster(photo, photos)).as_bytes());
    (row, measure)
}

fn fold(photos: usize) {
    let duplicate = STAGES.iter().find(|stage| stage.name == "duplicate").unwrap();
    let bound = (duplicate.bind)(serde_json::json!({})).unwrap();
    let Work::Fold(duplicate) = bound.work() else {
        unreachable!("duplicate is a fold")
    };
    let harness = Harness::default();
    let store = Store {
        put: Mutex::default(),
        planes_read: Mutex::default(),
    };
    let ctx = Ctx {
        blobs: &store,
        ..harness.ctx()
    };
    let sol = |state: &mut dyn FoldState, sol: usize| {
        let made: Vec<(Row, Vec<u8>)> = (sol * SOL..(sol + 1) * SOL).map(|at| photo(at, photos)).collect();
        let items: Vec<Measured<'_>> = made
            .iter()
            .map(|(row, measure)| Measured {
                shard: sol as u32,
                row,
                measure,
            })
            .collect();
        let clock = Clock::now();
        let (added, verdicts) = state.fold(&ctx, &items).unwrap();
        let kept = verdicts.iter().filter(|verdict| verdict.keeps()).count();
        (clock.seconds(), added, kept)
    };
    let sols = photos / SOL;
    let before = resident_mb();
    let mut state = duplicate.begin();
    let (mut seconds, mut kept, mut added, mut last) = (0.0, 0, Vec::new(), 0.0);
    for at in 0..sols {
        let (spent, bytes, keeps) = sol(&mut *state, at);
        seconds += spent;
        last = spent;
        kept += keeps;
        added.push(bytes);
    }
    let stored: usize = store.put.lock().unwrap().values().map(|bytes| bytes.len()).sum();
    let written: usize = added.iter().map(Vec::len).sum();
    let memory = resident_mb() - before - (stored + written) as f64 / (1 << 20) as f64;
    println!(
        "{photos} photos in {sols} sols: {seconds:.1} CPU s, the last sol {last:.3} s; {kept} kept; state {memory:.0} MB; added \
         {:.1} MB and {:.1} MB in blobs; planes read {} times",
        written as f64 / 1e6,
        stored as f64 / 1e6,
        store.planes_read.lock().unwrap()
    );
    drop(state);
    let clock = Clock::now();
    let mut state = duplicate.begin();
    added.iter().for_each(|added| state.replay(&ctx, added).unwrap());
    let replayed = clock.seconds();
    let (next, ..) = black_box(sol(&mut *state, sols));
    println!("  one more sol: replay {replayed:.2} CPU s, fold {next:.2} CPU s");
}
