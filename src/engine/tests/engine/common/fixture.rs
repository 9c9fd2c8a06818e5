//! The archive in memory that stages of a test read, and the log of their work.

use std::{
    collections::BTreeMap,
    sync::{
        Arc, LazyLock,
        atomic::{AtomicU64, Ordering},
    },
};

use parking_lot::Mutex;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

type AtMeasure = Box<dyn Fn(usize) + Send>;
type AtDraw = Arc<dyn Fn(u64) + Send + Sync>;
type AtSum = Arc<dyn Fn() + Send + Sync>;
type AtList = Arc<dyn Fn() + Send + Sync>;
type AtContext = Arc<dyn Fn(usize) + Send + Sync>;

/// The archive of one test (shard -> name -> number), and a log of what its stages did.
///
/// Stages find it by a number that is in no key.
#[derive(Default)]
pub struct Fixture {
    pub archive: Mutex<BTreeMap<u32, BTreeMap<String, u64>>>,
    pub fetched: Mutex<Vec<u32>>,
    pub measured: Mutex<Vec<String>>,
    pub folded: Mutex<Vec<u32>>,
    pub ran: AtomicU64,
    /// Number of reductions of children.
    pub reduced: AtomicU64,
    /// Called at every listing, which then looks for the wish to stop.
    pub at_list: Mutex<Option<AtList>>,
    /// Called at every measure with the number of earlier ones.
    pub at_measure: Mutex<Option<AtMeasure>>,
    /// Called when a sum begins.
    pub at_sum: Mutex<Option<AtSum>>,
    /// Called when a draw begins with the number of sums and draws before it.
    pub at_draw: Mutex<Option<AtDraw>>,
    /// Called when the context of a pass is made.
    pub at_context: Mutex<Option<AtContext>>,
    /// Threads that each sum was given.
    pub sum_threads: Mutex<Vec<usize>>,
}

static FIXTURES: LazyLock<Mutex<BTreeMap<u64, Arc<Fixture>>>> = LazyLock::new(Mutex::default);
static NEXT_ID: AtomicU64 = AtomicU64::new(1);

/// Returns a new fixture and its number.
pub fn new_fixture() -> (u64, Arc<Fixture>) {
    let number = NEXT_ID.fetch_add(1, Ordering::Relaxed);
    let fixture = Arc::new(Fixture::default());
    FIXTURES.lock().insert(number, Arc::clone(&fixture));
    (number, fixture)
}

/// Returns the fixture of a number.
pub fn fixture(number: u64) -> Arc<Fixture> {
    Arc::clone(&FIXTURES.lock()[&number])
}

impl Fixture {
    /// Puts a photo into the archive, or replaces it.
    pub fn put(&self, shard: u32, name: &str, number: u64) {
        let mut archive = self.archive.lock();
        archive.entry(shard).or_default().insert(name.to_owned(), number);
    }

    /// Puts ten photos into a shard, with the numbers 0..10 times the shard.
    pub fn put_shard(&self, shard: u32) {
        (0..10).for_each(|number| self.put(shard, &format!("s{shard}-{number}"), number * u64::from(shard)));
    }

    /// Takes the shards fetched since the last call.
    pub fn take_fetched(&self) -> Vec<u32> {
        std::mem::take(&mut self.fetched.lock())
    }

    /// Takes the number of measures since the last call.
    pub fn take_measured(&self) -> usize {
        std::mem::take(&mut *self.measured.lock()).len()
    }

    /// Takes the shards folded since the last call.
    pub fn take_folded(&self) -> Vec<u32> {
        std::mem::take(&mut self.folded.lock())
    }

    /// Clears the log.
    pub fn clear_log(&self) {
        self.take_fetched();
        self.take_measured();
        self.take_folded();
        self.take_ran();
    }

    /// Takes the number of set stages run since the last call.
    pub fn take_ran(&self) -> u64 {
        self.ran.swap(0, Ordering::Relaxed)
    }
}

/// Number of the fixture that a stage uses. It is not part of a key.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct FixtureId(pub u64);
