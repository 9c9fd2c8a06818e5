//! Best of several runs: other work on the machine only ever makes a run longer.

use std::time::Instant;

/// Runs at least 3 times and for 0.1 s, and returns the shortest time in seconds.
pub fn best(mut work: impl FnMut()) -> f64 {
    work();
    let (start, mut shortest, mut runs) = (Instant::now(), f64::MAX, 0);
    while runs < 3 || start.elapsed().as_secs_f64() < 0.1 {
        let begin = Instant::now();
        work();
        shortest = shortest.min(begin.elapsed().as_secs_f64());
        runs += 1;
    }
    shortest
}

/// Runs once and returns the time in seconds.
pub fn once(work: impl FnOnce()) -> f64 {
    let begin = Instant::now();
    work();
    begin.elapsed().as_secs_f64()
}

/// A pool of a fixed number of threads.
pub struct Threads(rayon::ThreadPool);

impl Threads {
    pub fn new(count: usize) -> Self {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build();
        Self(pool.expect("threads"))
    }

    /// Runs work on these threads.
    pub fn run<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        self.0.install(work)
    }

    /// Runs the timed work of every thread, given its number, all at once. Returns the runs a second of all.
    ///
    /// No thread waits for another: on a machine with other work a wait would be what is timed.
    pub fn rate(&self, time_s: impl Fn(usize) -> f64 + Sync) -> f64 {
        let times = self.0.broadcast(|context| time_s(context.index()));
        times.iter().map(|time_s| 1.0 / time_s).sum()
    }
}
