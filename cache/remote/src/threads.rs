//! The threads of requests. One that a file system keeps is left behind: nobody waits for it.

use std::{future::Future, io, time::Duration};

use tokio::{
    runtime::{Builder, Runtime},
    time::timeout,
};

/// Threads that read and write a folder: each has memory of its own that is not given back.
const FOLDER_THREADS: usize = 4;

/// Longest wait for a folder, which may be on a file system that hangs, besides the time for bytes.
pub(crate) const FOLDER_PATIENCE: Duration = Duration::from_secs(10);

/// Bytes that the slowest folder moves in a millisecond: 10 MB/s.
const BYTES_PER_MS: u64 = 10_000;

/// Returns the longest wait for a request to a folder that moves `bytes` bytes.
pub(crate) fn folder_patience(bytes: u64) -> Duration {
    FOLDER_PATIENCE + Duration::from_millis(bytes / BYTES_PER_MS)
}

/// Threads that end with this, without those that wait for a file system.
pub(crate) struct Threads(Option<Runtime>);

impl Threads {
    pub(crate) fn new() -> io::Result<Self> {
        let runtime = Builder::new_multi_thread()
            .worker_threads(2)
            .max_blocking_threads(FOLDER_THREADS)
            .enable_all()
            .build()?;
        Ok(Self(Some(runtime)))
    }

    /// Waits for work.
    ///
    /// # Panics
    /// Never: the threads are there until this is dropped.
    pub(crate) fn block_on<T>(&self, work: impl Future<Output = T>) -> T {
        match &self.0 {
            Some(runtime) => runtime.block_on(work),
            None => unreachable!("the threads are there until this is dropped"),
        }
    }
}

impl Drop for Threads {
    fn drop(&mut self) {
        if let Some(runtime) = self.0.take() {
            runtime.shutdown_background();
        }
    }
}

/// Returns the result of a call that may block for ever, or an error after `patience`.
pub(crate) async fn unblocked<T: Send + 'static>(
    patience: Duration,
    call: impl FnOnce() -> T + Send + 'static,
) -> io::Result<T> {
    let silent = || {
        io::Error::new(
            io::ErrorKind::TimedOut,
            format!("no answer within {} s", patience.as_secs_f64()),
        )
    };
    let answer = timeout(patience, tokio::task::spawn_blocking(call)).await;
    answer.map_err(|_| silent())?.map_err(io::Error::other)
}

#[cfg(test)]
mod tests {
    use std::{sync::mpsc, time::Instant};

    use super::*;

    #[test]
    fn a_call_that_blocks_is_left_behind() {
        let (release, blocked) = mpsc::channel::<()>();
        let began = Instant::now();
        let threads = Threads::new().unwrap();
        let answer = threads.block_on(unblocked(Duration::from_millis(50), move || blocked.recv()));
        assert_eq!(answer.unwrap_err().to_string(), "no answer within 0.05 s");
        assert_eq!(threads.block_on(unblocked(FOLDER_PATIENCE, || 7)).unwrap(), 7);
        drop(threads);
        assert!(began.elapsed() < FOLDER_PATIENCE, "{:?}", began.elapsed());
        drop(release);
    }
}
