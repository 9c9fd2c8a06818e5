//! An open shared store: its verbs, each a blocking call.

use std::{
    future::Future,
    pin::pin,
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use bytes::Bytes;
use futures_util::future::{Either, select};
use marf_cache::{Digest, Store};

use crate::{
    address::Patience,
    bucket::{Bucket, Traffic},
    error::RemoteError,
    fsck::{self, FsckOptions, RemoteFsckReport},
    gc::{self, GcOptions, RemoteGcReport},
    lease::{Kind, Lease},
    names,
    observer::Observer,
    pull::{self, PullReport},
    push::{self, PushReport},
    sealed::RemoteRun,
    threads::{FOLDER_PATIENCE, Threads, unblocked},
    trust::Trust,
};

/// Form of shared stores that this program reads and writes.
const FORMAT: u32 = 1;
/// First words of the format object.
const FORMAT_WORDS: &str = "marf shared store ";

/// Longest wait for the end of a lease: the user may have asked to stop.
const RELEASE_PATIENCE: Duration = Duration::from_secs(1);

/// A shared store.
pub struct Remote {
    pub(crate) bucket: Bucket,
    /// Whether its format has been checked.
    is_checked: AtomicBool,
    threads: Threads,
}

impl Remote {
    /// Opens the shared store at `s3://BUCKET/PREFIX` or `file:///FOLDER` without a request to it. Credentials, endpoint and
    /// region come from the environment (`AWS_*`). `trust` holds the key that signs and the writers whose results are
    /// trusted.
    ///
    /// # Errors
    /// A bad address, or an environment without credentials.
    pub fn open(url: &str, patience: Patience, trust: Trust) -> Result<Self, RemoteError> {
        let threads = Threads::new().map_err(RemoteError::Threads)?;
        let place = url.to_owned();
        let open = move || Bucket::open(&place, patience, trust);
        let opened = threads.block_on(unblocked(FOLDER_PATIENCE, open));
        let silent = |error: std::io::Error| RemoteError::Failed {
            place: url.to_owned(),
            doing: "open",
            object: "format".to_owned(),
            cause: error.to_string(),
        };
        Ok(Self {
            bucket: opened.map_err(silent)??,
            is_checked: AtomicBool::new(false),
            threads,
        })
    }

    /// Returns its address.
    pub fn place(&self) -> &str {
        &self.bucket.place
    }

    /// Returns requests and bytes so far.
    pub fn traffic(&self) -> Traffic {
        self.bucket.traffic()
    }

    /// Sends a run with everything that it consists of and the shared store lacks.
    ///
    /// Conflicts are not an error: the result that is already there stays, and the report lists both.
    ///
    /// # Errors
    /// Returns an error if the shared store cannot be written, or if the local store lacks a result.
    pub fn push(
        &self,
        store: &Store,
        run: &RemoteRun,
        observer: &dyn Observer,
    ) -> Result<PushReport, RemoteError> {
        let work = async {
            self.make().await?;
            push::run(&self.bucket, store, run, observer).await
        };
        self.holding(&Lease::new(Kind::Shared), observer, work)
    }

    /// Returns the runs of a pipeline that are there, the newest first: start in seconds since 1970, digest of the root.
    /// Without a pipeline those of all.
    ///
    /// # Errors
    /// A shared store that is absent or cannot be read.
    pub fn runs(
        &self,
        pipeline: Option<&str>,
        observer: &dyn Observer,
    ) -> Result<Vec<(u64, Digest)>, RemoteError> {
        let folder = pipeline.map_or_else(|| names::RUNS.to_owned(), names::runs_of);
        self.waiting(observer, async {
            self.check().await?;
            let listed = self.bucket.list(&folder).await?;
            let mut runs: Vec<_> = listed
                .iter()
                .filter_map(|object| names::run_in(&object.name))
                .collect();
            runs.sort_unstable_by(|a, b| b.cmp(a));
            Ok(runs)
        })
    }

    /// Reads a run by the digest of its root.
    ///
    /// # Errors
    /// A run that is not there or damaged.
    pub fn run(&self, root: &Digest, observer: &dyn Observer) -> Result<RemoteRun, RemoteError> {
        self.waiting(observer, pull::read_run(&self.bucket, root))
    }

    /// Fetches everything that a run consists of and the local store lacks. The run itself is not added to
    /// the store.
    ///
    /// # Errors
    /// Returns an error if the shared store cannot be read or is incomplete, or if the local store cannot be
    /// written.
    pub fn pull(
        &self,
        store: &Store,
        run: &RemoteRun,
        observer: &dyn Observer,
    ) -> Result<PullReport, RemoteError> {
        self.waiting(observer, pull::run(&self.bucket, store, run, observer))
    }

    /// Fetches the existing results of these keys, with everything that belongs to them. Returns why some of them were not
    /// fetched: they are damaged, incomplete, or take longer to fetch than to compute, but at least `least_wait`.
    ///
    /// # Errors
    /// Returns an error if the shared store cannot be read or the local store cannot be written. An absent shared store is
    /// not an error.
    pub fn fetch(
        &self,
        store: &Store,
        keys: &[Digest],
        least_wait: Duration,
        observer: &dyn Observer,
    ) -> Result<Vec<RemoteError>, RemoteError> {
        self.waiting(observer, async {
            match self.check().await {
                Err(RemoteError::Absent { .. }) => Ok(Vec::new()),
                Err(error) => Err(error),
                Ok(()) => pull::what_is_there(&self.bucket, store, keys, least_wait, observer).await,
            }
        })
    }

    /// Removes what no kept run needs and what is older than the grace.
    ///
    /// # Errors
    /// A shared store that is absent, damaged where it matters, or in use ([`RemoteError::Busy`]).
    pub fn gc(&self, options: GcOptions, observer: &dyn Observer) -> Result<RemoteGcReport, RemoteError> {
        let lease = Lease::new(Kind::Exclusive);
        let work = async {
            self.check().await?;
            gc::collect(&self.bucket, &lease, options).await
        };
        if options.dry_run {
            self.waiting(observer, work)
        } else {
            self.holding(&lease, observer, work)
        }
    }

    /// Checks that every record, run and index is whole and that what it names is there.
    ///
    /// # Errors
    /// A shared store that is absent or cannot be read, or for a repair is in use ([`RemoteError::Busy`]).
    pub fn fsck(
        &self,
        options: FsckOptions,
        observer: &dyn Observer,
    ) -> Result<RemoteFsckReport, RemoteError> {
        let work = async {
            self.check().await?;
            fsck::check(&self.bucket, options).await
        };
        if options.repair {
            self.holding(&Lease::new(Kind::Exclusive), observer, work)
        } else {
            self.waiting(observer, work)
        }
    }

    /// Makes the shared store if it is absent, and checks its form.
    pub(crate) async fn make(&self) -> Result<(), RemoteError> {
        match self.check().await {
            Err(RemoteError::Absent { .. }) => {
                let words = Bytes::from(format!("{FORMAT_WORDS}{FORMAT}\n"));
                self.bucket.put_new(names::FORMAT, words).await?;
                self.check().await
            }
            checked => checked,
        }
    }

    /// Checks the form, once.
    pub(crate) async fn check(&self) -> Result<(), RemoteError> {
        if self.is_checked.load(Ordering::Relaxed) {
            return Ok(());
        }
        let place = || self.bucket.place.clone();
        let Some(bytes) = self.bucket.get(names::FORMAT).await? else {
            return Err(RemoteError::Absent { place: place() });
        };
        let text = String::from_utf8_lossy(&bytes);
        let Some(found) = text.trim().strip_prefix(FORMAT_WORDS) else {
            return Err(self.bucket.damaged(names::FORMAT, "it is of another program"));
        };
        if found != FORMAT.to_string() {
            return Err(RemoteError::Newer {
                place: place(),
                found: found.to_owned(),
                known: FORMAT,
            });
        }
        self.is_checked.store(true, Ordering::Relaxed);
        Ok(())
    }

    /// Waits for work, or until the user wants to stop.
    pub(crate) fn waiting<T>(
        &self,
        observer: &dyn Observer,
        work: impl Future<Output = Result<T, RemoteError>>,
    ) -> Result<T, RemoteError> {
        self.threads.block_on(until_stopped(observer, work))
    }

    /// Waits for work as [`Remote::waiting`], under a lease that is renewed meanwhile and released in any case.
    pub(crate) fn holding<T>(
        &self,
        lease: &Lease,
        observer: &dyn Observer,
        work: impl Future<Output = Result<T, RemoteError>>,
    ) -> Result<T, RemoteError> {
        let bucket = &self.bucket;
        let work = async {
            lease.take(bucket).await?;
            work.await
        };
        self.threads.block_on(async {
            let work = pin!(until_stopped(observer, work));
            let done = match select(work, pin!(lease.renew(bucket))).await {
                Either::Left((done, _)) => done,
                Either::Right((lost, _)) => Err(lost),
            };
            // A lease that cannot be released ends by itself.
            let _ = tokio::time::timeout(RELEASE_PATIENCE, lease.release(bucket)).await;
            done
        })
    }
}

async fn until_stopped<T>(
    observer: &dyn Observer,
    work: impl Future<Output = Result<T, RemoteError>>,
) -> Result<T, RemoteError> {
    if observer.is_stopped() {
        return Err(RemoteError::Stopped);
    }
    let stopped = async {
        while !observer.is_stopped() {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    match select(pin!(work), pin!(stopped)).await {
        Either::Left((done, _)) => done,
        Either::Right(_) => Err(RemoteError::Stopped),
    }
}
