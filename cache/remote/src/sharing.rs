//! A shared store used during a run: existing results are fetched instead of computed, and new results are
//! sent.

use std::{
    fmt,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{self, Receiver, Sender},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant, SystemTime},
};

use marf_cache::{Digest, Record, Store};

use crate::{
    conflict::in_words,
    error::RemoteError,
    observer::{Observer, Progress},
    remote::Remote,
    sealed::RemoteRun,
};

/// A result that would take longer to fetch than it took to make is made, but so long is waited for each.
const LEAST_WAIT: Duration = Duration::from_secs(10);

/// Wait for the end of the lease when nothing more is to be sent.
const LAST_WAIT: Duration = Duration::from_millis(1_200);
/// Pause between two looks whether everything is sent.
const LOOK_INTERVAL: Duration = Duration::from_millis(10);

/// Shows a warning to the user.
type Warn = Arc<dyn Fn(String) + Send + Sync>;

/// A shared store used during a run. Its first failure is reported once, and the run goes on without it.
pub struct Sharing {
    link: Arc<Link>,
    queue: Sender<Job>,
    sender: JoinHandle<()>,
}

/// State shared by the run and the thread that sends.
struct Link {
    remote: Remote,
    /// A separate handle of the local store. It sees committed results.
    store: Store,
    warn: Warn,
    is_stopped: Arc<dyn Fn() -> bool + Send + Sync>,
    /// Results of others that are computed again instead of fetched.
    recheck: Recheck,
    /// Set after the first failure: an unavailable server gets no further request.
    is_away: AtomicBool,
    /// Set when the run has waited long enough for what is being sent.
    is_late: AtomicBool,
}

/// A sample of keys.
struct Recheck {
    share: f64,
    /// A different sample in each run: the writer of a wrong result cannot know which results are computed
    /// again.
    salt: [u8; 32],
}

impl Recheck {
    fn new(share: f64) -> Self {
        let since = SystemTime::now()
            .duration_since(SystemTime::UNIX_EPOCH)
            .unwrap_or_default();
        let seed = format!("{} {}", since.as_nanos(), std::process::id());
        Self {
            share,
            salt: *Digest::from_content(seed.as_bytes()).as_bytes(),
        }
    }

    fn has(&self, key: &Digest) -> bool {
        let drawn = Digest::from_content(&[self.salt.as_slice(), key.as_bytes()].concat());
        let number = drawn
            .as_bytes()
            .iter()
            .take(4)
            .fold(0_u32, |number, byte| number << 8 | u32::from(*byte));
        f64::from(number) < self.share * 2_f64.powi(32)
    }
}

/// Work for the thread that sends.
enum Job {
    Result(Digest),
    Run(Box<RemoteRun>),
    End,
}

impl Sharing {
    /// Connects a shared store to a run whose local store is in the folder `store`. A share of the existing results, 0 to 1, is
    /// not fetched: the run computes them again. When it sends them, a different result is reported as a conflict.
    ///
    /// # Errors
    /// Returns an error if the local store cannot be opened.
    pub fn start(
        remote: Remote,
        verify_share: f64,
        store: &Path,
        warn: impl Fn(String) + Send + Sync + 'static,
        is_stopped: impl Fn() -> bool + Send + Sync + 'static,
    ) -> Result<Self, RemoteError> {
        let link = Arc::new(Link {
            remote,
            store: Store::open(PathBuf::from(store))?,
            warn: Arc::new(warn),
            recheck: Recheck::new(verify_share),
            is_stopped: Arc::new(is_stopped),
            is_away: AtomicBool::new(false),
            is_late: AtomicBool::new(false),
        });
        let (queue, jobs) = mpsc::channel();
        let sending = Arc::clone(&link);
        let sender = thread::spawn(move || sending.send_all(&jobs));
        Ok(Self { link, queue, sender })
    }

    /// Fetches the existing results of keys, each with everything that belongs to it.
    pub fn fetch(&self, keys: &[Digest]) {
        let link = &self.link;
        if link.is_away() {
            return;
        }
        let believed: Vec<Digest> = keys
            .iter()
            .filter(|key| !link.recheck.has(key))
            .copied()
            .collect();
        match link
            .remote
            .fetch(&link.store, &believed, LEAST_WAIT, link.as_ref())
        {
            Ok(skipped) => skipped.into_iter().for_each(|error| link.tell(&error)),
            Err(error) => link.give_up(&error),
        }
    }

    /// Returns the record of a key if it exists and is trusted, or `None` if the run computes it again.
    pub fn record(&self, key: &Digest) -> Option<Record> {
        let link = &self.link;
        if link.is_away() || link.recheck.has(key) {
            return None;
        }
        match link.remote.record(key, link.as_ref()) {
            Ok(record) => record,
            Err(error @ RemoteError::Damaged { .. }) => {
                link.tell(&error);
                None
            }
            Err(error) => {
                link.give_up(&error);
                None
            }
        }
    }

    /// Sends the result of a key, which is committed, when its turn comes.
    pub fn offer(&self, key: &Digest) {
        let _ = self.queue.send(Job::Result(*key));
    }

    /// Sends a run and waits at most `patience` until it and all results before it are sent. Nothing may be offered
    /// after this call.
    pub fn finish(&self, run: Option<RemoteRun>, patience: Duration) {
        if let Some(run) = run {
            let _ = self.queue.send(Job::Run(Box::new(run)));
        }
        let _ = self.queue.send(Job::End);
        let link = &self.link;
        if !self.ends_within(patience, || (link.is_stopped)()) {
            (link.warn)(format!(
                "not all results are in the shared store {} yet: `marf cache push` sends the others",
                link.remote.place()
            ));
            link.is_late.store(true, Ordering::Relaxed);
            self.ends_within(LAST_WAIT, || false);
        }
    }

    /// Waits until everything is sent, at most `patience` or until `is_stopped`. Returns whether everything
    /// is sent.
    fn ends_within(&self, patience: Duration, is_stopped: impl Fn() -> bool) -> bool {
        let began = Instant::now();
        while !self.sender.is_finished() && began.elapsed() < patience && !is_stopped() {
            thread::sleep(LOOK_INTERVAL);
        }
        self.sender.is_finished()
    }
}

impl fmt::Debug for Sharing {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_tuple("Sharing")
            .field(&self.link.remote.place())
            .finish()
    }
}

impl Link {
    fn is_away(&self) -> bool {
        self.is_away.load(Ordering::Relaxed)
    }

    /// Sends jobs until the last. Results that are ready at the same time are sent together.
    fn send_all(&self, jobs: &Receiver<Job>) {
        let mut is_last = false;
        while !is_last && let Ok(first) = jobs.recv() {
            let mut keys = Vec::new();
            let mut run = None;
            for job in std::iter::once(first).chain(jobs.try_iter()) {
                match job {
                    Job::Result(key) => keys.push(key),
                    Job::Run(last) => run = Some(last),
                    Job::End => is_last = true,
                }
            }
            let is_empty = keys.is_empty() && run.is_none();
            if !is_empty
                && !self.is_away()
                && let Err(error) = self.send(&keys, run.as_deref())
            {
                self.give_up(&error);
            }
        }
    }

    fn send(&self, keys: &[Digest], run: Option<&RemoteRun>) -> Result<(), RemoteError> {
        let pushed = match run {
            None => self.remote.send(&self.store, keys, &[], self)?,
            // A run names all its results.
            Some(run) => self.remote.push(&self.store, run, self)?,
        };
        pushed
            .conflicts
            .iter()
            .for_each(|conflict| (self.warn)(in_words(conflict)));
        Ok(())
    }

    fn tell(&self, error: &RemoteError) {
        (self.warn)(format!("{error}. The result is computed here"));
    }

    /// Reports the first failure and stops using the shared store.
    fn give_up(&self, error: &RemoteError) {
        if matches!(error, RemoteError::Stopped) || self.is_away.swap(true, Ordering::Relaxed) {
            return;
        }
        let hint = error.hint().map(|hint| format!(" ({hint})")).unwrap_or_default();
        (self.warn)(format!(
            "{error}{hint}. The run goes on without the shared store. `marf cache push` sends its results later"
        ));
    }
}

impl Observer for Link {
    fn on_progress(&self, _progress: Progress) {}

    fn is_stopped(&self) -> bool {
        self.is_late.load(Ordering::Relaxed) || (self.is_stopped)()
    }
}
