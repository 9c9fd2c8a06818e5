//! How near duplicates are found among many photos: the fold of `duplicate` over sols of 1,000 photos.
//!
//! usage: cargo bench -p marf-filter --bench fold [-- PHOTOS...]. Default: 10,000 and 100,000 photos.
//! The hashes are synthetic: 70 % drawn, 30 % in clusters of up to 500 within 6 bits of a centre, spread over all sols. The planes of a cluster differ by noise, so that its photos are duplicates of the first one. Nothing is
//! written to disk: descriptors and planes are generated on request.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a bench that a person runs"
)]

use std::collections::BTreeMap;
use std::hint::black_box;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::{fs, time::Instant};

use marf_cache::{Digest, manifest::Row};
use marf_filter::STAGES;
use marf_stage::{BlobError, Blobs, Ctx, FoldState, Measured, Work, harness::Harness};

/// Photos of a sol.
const SOL: usize = 1000;

fn main() {
    let words = std::env::args().skip(1);
    let mut counts: Vec<usize> = words.filter_map(|word| word.parse().ok()).collect();
    if counts.is_empty() {
        counts = vec![10_000, 100_000];
    }
    counts.into_iter().for_each(fold);
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

/// Returns a photo as a row and as its measure, which has a first byte 1, then size, sharpness, colour, hashes, and the digest of
/// the planes.
fn photo(photo: usize, photos: usize) -> (Row, Vec<u8>) {
    let row = Row {
        id: format!("NLF_{photo:07}_0671382174_448ECM"),
        blobs: BTreeMap::new(),
        facts: serde_json::json!({"file": "", "width": 1280, "height": 960, "sol": photo / SOL}),
    };
    let planes = Store::planes_digest(photo, cluster(photo, photos));
    let sharpness = mixed(!photo as u64) as f64;
    let hashes = vec![hash_of(photo, photos)];
    let descriptor = ([1280_u32, 960], sharpness, 0.1, hashes, planes.as_bytes());
    let measure = [vec![1], postcard::to_allocvec(&descriptor).unwrap()].concat();
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
