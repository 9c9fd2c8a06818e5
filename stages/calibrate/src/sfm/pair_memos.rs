//! Results of pairs of photos, kept from run to run in one table a photo.
//!
//! A pair with a photo that has no table yet goes into the table of that photo. New photos write new tables and leave the others as they
//! are.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use marf_cache::{Digest, digest_of};
use marf_stage::{Ctx, StageError};
use rayon::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

const MAGIC: &[u8; 8] = b"marftab3";

/// Wall clock after which finished pairs are saved.
const SAVE_EVERY: Duration = Duration::from_secs(10);

/// A function of pairs of photos.
pub(super) trait PairFunction: Sync {
    /// What it returns and what is kept. It must not hold the places of photos, which differ from run to run.
    type Output: Clone + Send + Serialize + DeserializeOwned;
    /// Progress for people.
    const NOTE: &'static str;

    /// Returns the digest of its version and parameters.
    fn table(&self) -> Digest;

    /// Returns the digest of everything else that a pair depends on.
    fn key(&self, photos: [usize; 2]) -> Digest;

    /// Computes a pair with this key.
    fn compute(&self, photos: [usize; 2], key: &Digest) -> Self::Output;
}

/// Returns the result of `work` for each pair, in order. Results of an earlier run are taken from the tables.
///
/// `photos` identify the photos. Every pair needs a different key.
///
/// # Errors
/// A request to stop. The finished results are then saved.
pub(super) fn map_pairs<W: PairFunction>(
    ctx: &Ctx<'_>,
    photos: &[Digest],
    pairs: &[[usize; 2]],
    work: &W,
) -> Result<Vec<W::Output>, StageError> {
    let tables = Mutex::new(Tables::load(ctx, work.table(), photos, pairs)?);
    let done = AtomicU64::new(0);
    let find = |&pair: &[usize; 2]| {
        ctx.check()?;
        let (key, names) = (work.key(pair), pair.map(|photo| photos[photo]));
        let kept = locked(&tables).get(&names, &key);
        let found = kept.unwrap_or_else(|| {
            let found = work.compute(pair, &key);
            locked(&tables).insert(ctx, &names, &key, found.clone());
            found
        });
        let so_far = done.fetch_add(1, Ordering::Relaxed) + 1;
        ctx.progress.at(so_far, pairs.len() as u64, W::NOTE);
        Ok(found)
    };
    let found: Result<Vec<W::Output>, StageError> = pairs.par_iter().map(find).collect();
    locked(&tables).save(ctx);
    found
}

/// A lock that another thread left by a panic still holds whole rows.
fn locked<T>(tables: &Mutex<Tables<T>>) -> std::sync::MutexGuard<'_, Tables<T>> {
    tables.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// The tables of the photos of some pairs.
struct Tables<T> {
    of: Digest,
    by_photo: BTreeMap<Digest, Table<T>>,
    saved_at: Instant,
}

/// The pairs of a photo by their keys.
struct Table<T> {
    rows: BTreeMap<[u8; 32], T>,
    /// Whether an earlier run has left it.
    known: bool,
    changed: bool,
}

impl<T: Clone + Send + Serialize + DeserializeOwned> Tables<T> {
    /// Reads the tables of the photos of the pairs.
    fn load(ctx: &Ctx<'_>, of: Digest, photos: &[Digest], pairs: &[[usize; 2]]) -> Result<Self, StageError> {
        let mut names: Vec<Digest> = pairs.iter().flatten().map(|&photo| photos[photo]).collect();
        names.sort_unstable();
        names.dedup();
        let read = |photo: Digest| {
            ctx.check()?;
            let kept = ctx.memos.load(&digest_of(&(of, photo)));
            let rows = kept.and_then(|bytes| decode(&bytes));
            Ok((
                photo,
                Table {
                    known: rows.is_some(),
                    rows: rows.unwrap_or_default(),
                    changed: false,
                },
            ))
        };
        let by_photo: Result<_, StageError> = names.into_par_iter().map(read).collect();
        Ok(Self {
            of,
            by_photo: by_photo?,
            saved_at: Instant::now(),
        })
    }

    /// Returns a row from the table of either photo.
    fn get(&self, photos: &[Digest; 2], key: &Digest) -> Option<T> {
        let tables = photos.iter().filter_map(|photo| self.by_photo.get(photo));
        let mut rows = tables.filter_map(|table| table.rows.get(key.as_bytes()));
        rows.next().cloned()
    }

    /// Adds a row to the table of the photo that is new, else to that of the first, and saves now and then.
    fn insert(&mut self, ctx: &Ctx<'_>, [first, second]: &[Digest; 2], key: &Digest, row: T) {
        let known = |photo: &Digest| self.by_photo.get(photo).is_some_and(|table| table.known);
        let home = if known(first) && !known(second) {
            second
        } else {
            first
        };
        if let Some(table) = self.by_photo.get_mut(home) {
            table.rows.insert(*key.as_bytes(), row);
            table.changed = true;
        }
        if self.saved_at.elapsed() >= SAVE_EVERY {
            self.save(ctx);
        }
    }

    /// Writes the tables with new rows.
    fn save(&mut self, ctx: &Ctx<'_>) {
        for (photo, table) in &mut self.by_photo {
            if std::mem::take(&mut table.changed) {
                ctx.memos
                    .save(&digest_of(&(self.of, *photo)), &encode(&table.rows));
            }
        }
        self.saved_at = Instant::now();
    }
}

fn encode<T: Serialize>(rows: &BTreeMap<[u8; 32], T>) -> Vec<u8> {
    // Only lists of unknown length cannot be written, and rows have none. `decode` refuses empty bytes.
    postcard::to_extend(rows, MAGIC.to_vec()).unwrap_or_default()
}

fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Option<BTreeMap<[u8; 32], T>> {
    let (rows, rest) = postcard::take_from_bytes(bytes.strip_prefix(MAGIC)?).ok()?;
    rest.is_empty().then_some(rows)
}

#[cfg(test)]
mod tests {
    use marf_stage::{Cancel, Memos, harness::Harness};

    use super::*;

    /// Sums of pairs of numbers. Counts the computed ones.
    #[derive(Default)]
    struct Sums {
        computed: AtomicU64,
    }

    impl PairFunction for Sums {
        type Output = usize;
        const NOTE: &'static str = "sums";

        fn table(&self) -> Digest {
            Digest::from_content(b"sums 1")
        }

        fn key(&self, [a, b]: [usize; 2]) -> Digest {
            Digest::from_content(format!("{a} {b}").as_bytes())
        }

        fn compute(&self, [a, b]: [usize; 2], _key: &Digest) -> usize {
            self.computed.fetch_add(1, Ordering::Relaxed);
            a + b
        }
    }

    fn photos(count: usize) -> Vec<Digest> {
        (0..count)
            .map(|photo| Digest::from_content(&[photo as u8]))
            .collect()
    }

    fn pairs(count: usize) -> Vec<[usize; 2]> {
        (0..count)
            .flat_map(|a| (a + 1..count).map(move |b| [a, b]))
            .collect()
    }

    /// Returns how many pairs were computed.
    fn run(harness: &Harness, count: usize) -> u64 {
        let work = Sums::default();
        let found = map_pairs(&harness.ctx(), &photos(count), &pairs(count), &work).unwrap();
        let sums: Vec<usize> = pairs(count).iter().map(|[a, b]| a + b).collect();
        assert_eq!(found, sums);
        work.computed.into_inner()
    }

    fn table(harness: &Harness, photo: usize) -> Option<usize> {
        let key = digest_of(&(Sums::default().table(), photos(photo + 1)[photo]));
        Some(decode::<usize>(&Memos::load(harness, &key)?)?.len())
    }

    #[test]
    fn a_new_photo_writes_its_own_table_and_no_other() {
        let harness = Harness::default();
        assert_eq!(run(&harness, 6), 15);
        let before: Vec<Option<usize>> = (0..6).map(|photo| table(&harness, photo)).collect();
        assert_eq!(before, [Some(5), Some(4), Some(3), Some(2), Some(1), None]);
        assert_eq!(run(&harness, 6), 0);
        assert_eq!(run(&harness, 8), 13);
        let after: Vec<Option<usize>> = (0..5).map(|photo| table(&harness, photo)).collect();
        assert_eq!(after, before[..5]);
        // Photo 5 had no table: its pairs lay with the others.
        let new: Vec<Option<usize>> = (5..8).map(|photo| table(&harness, photo)).collect();
        assert_eq!(new, [Some(2), Some(6), Some(5)]);
    }

    #[test]
    fn a_run_that_is_stopped_keeps_what_it_has() {
        for checks in [0, 7, 9, 15, 21] {
            let harness = Harness::default();
            let cancel = Cancel::after(checks);
            let ctx = Ctx {
                cancel: &cancel,
                ..harness.ctx()
            };
            let first = Sums::default();
            let stopped = map_pairs(&ctx, &photos(6), &pairs(6), &first);
            // Six tables are read, then fifteen pairs are computed. Each step checks once for a stop.
            assert_eq!(stopped.is_ok(), checks >= 21, "{checks}");
            assert_eq!(first.computed.into_inner() + run(&harness, 6), 15, "{checks}");
        }
    }

    #[test]
    fn a_table_comes_back_and_a_damaged_one_costs_only_time() {
        let harness = Harness::default();
        run(&harness, 4);
        let key = digest_of(&(Sums::default().table(), photos(1)[0]));
        let whole = Memos::load(&harness, &key).unwrap();
        for damaged in [&whole[..0], &whole[..whole.len() - 1], b"other"] {
            Memos::save(&harness, &key, damaged);
            assert_eq!(run(&harness, 4), 3, "{} bytes", damaged.len());
            assert_eq!(run(&harness, 4), 0);
        }
    }
}
