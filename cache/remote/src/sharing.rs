//! A shared store beside a run: results are fetched before they are made, and sent when they are made.

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

/// Tells people of something.
type Warn = Arc<dyn Fn(String) + Send + Sync>;

/// A shared store beside a run. What goes wrong is told once, and the run goes on without it.
pub struct Sharing {
    link: Arc<Link>,
    queue: Sender<Job>,
    sender: JoinHandle<()>,
}

/// What the run and the thread that sends have in common.
struct Link {
    remote: Remote,
    /// A handle of its own on the own store: it sees what is committed.
    store: Store,
    warn: Warn,
    is_stopped: Arc<dyn Fn() -> bool + Send + Sync>,
    /// Which results of others are not believed but made again.
    recheck: Recheck,
    /// Set after the first failure: a server that is away is not asked again.
    is_away: AtomicBool,
    /// Set when the run has waited long enough for what is being sent.
    is_late: AtomicBool,
}

/// A sample of keys.
struct Recheck {
    share: f64,
    /// Another sample each run: who writes a wrong result does not know which are made again.
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

/// What the thread sends.
enum Job {
    Result(Digest),
    Run(Box<RemoteRun>),
    End,
}

impl Sharing {
    /// Puts a shared store beside a run whose own store is in this folder. A share of the results that are there, 0 to 1, is not
    /// fetched: the run makes them, and when it sends them, one that differs is told as a conflict.
    ///
    /// # Errors
    /// An own store that cannot be opened.
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

    /// Fetches the results of keys that are there, each with all that belongs to it.
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

    /// Returns the record of a key that is there and believed; none of one that the run would make again.
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

    /// Sends a run and waits at most so long until it and all results before it are sent; nothing is offered after it.
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

    /// Waits until everything is sent, for so long or until told to stop; returns whether everything is.
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

    /// Sends jobs until the last; results that are ready at one time go together.
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
        (self.warn)(format!("{error}; it is made here"));
    }

    /// Tells of a failure, the first time.
    fn give_up(&self, error: &RemoteError) {
        if matches!(error, RemoteError::Stopped) || self.is_away.swap(true, Ordering::Relaxed) {
            return;
        }
        let hint = error.hint().map(|hint| format!(" ({hint})")).unwrap_or_default();
        (self.warn)(format!(
            "{error}{hint}; the run goes on without the shared store, and `marf cache push` sends its results later"
        ));
    }
}

impl Observer for Link {
    fn on_progress(&self, _progress: Progress) {}

    fn is_stopped(&self) -> bool {
        self.is_late.load(Ordering::Relaxed) || (self.is_stopped)()
    }
}
