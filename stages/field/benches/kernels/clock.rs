//! Best of several runs: other work on the machine only ever makes a run longer.

use std::time::Instant;

/// Runs at least 3 times and for 0.1 s; returns the shortest time in seconds.
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

/// A pool of a fixed number of threads.
pub struct Threads {
    pub count: usize,
    pool: rayon::ThreadPool,
}

impl Threads {
    pub fn new(count: usize) -> Self {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build();
        Self {
            count,
            pool: pool.expect("threads"),
        }
    }

    pub fn run<T: Send>(&self, work: impl FnOnce(usize) -> T + Send) -> T {
        self.pool.install(|| work(self.count))
    }
}
