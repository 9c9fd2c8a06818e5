//! Leases: objects that list the programs working on a shared store.
//!
//! A program that adds has a lease of its own. One that removes has the exclusive lease. Each looks for the other after it
//! has written its own, so at least one of two sees the other. A lease is renewed every minute and ends ten minutes after
//! its last renewal, by the clock of the server.

use std::{
    sync::atomic::{AtomicU64, Ordering},
    time::{Duration, SystemTime},
};

use bytes::Bytes;
use marf_cache::Digest;

use crate::{bucket::Bucket, bucket::StoredObject, error::RemoteError, names};

/// Leases of this process so far.
static OPENED: AtomicU64 = AtomicU64::new(0);

const RENEWED_EVERY: Duration = Duration::from_secs(60);
const ENDS_AFTER: Duration = Duration::from_secs(600);

/// Most characters of a holder that are shown.
const MOST_HOLDER: usize = 100;

/// Name of the lease of a program that removes objects.
const EXCLUSIVE: &str = "exclusive";
/// Prefix of the names of leases of programs that add objects.
const SHARED: &str = "shared-";

/// What the names of objects begin with that are written for their time.
const CLOCK: &str = "clock-";

/// What a program does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// It adds objects.
    Shared,
    /// It removes objects.
    Exclusive,
}

/// The lease of this program, which ends with [`Lease::release`].
pub(crate) struct Lease {
    kind: Kind,
    name: String,
    clock: String,
    holder: String,
}

impl Lease {
    /// Returns a lease that is not taken yet.
    pub(crate) fn new(kind: Kind) -> Self {
        let holder = holder();
        let id = Digest::from_content(holder.as_bytes()).short();
        let name = match kind {
            Kind::Exclusive => EXCLUSIVE.to_owned(),
            Kind::Shared => format!("{SHARED}{id}"),
        };
        Self {
            kind,
            name: format!("{}/{name}", names::LEASES),
            clock: format!("{}/{CLOCK}{id}", names::LEASES),
            holder,
        }
    }

    /// Takes the lease.
    ///
    /// # Errors
    /// [`RemoteError::Busy`] where another program excludes this one.
    pub(crate) async fn take(&self, bucket: &Bucket) -> Result<(), RemoteError> {
        while !bucket.put_new(&self.name, self.bytes()).await? {
            self.take_over(bucket).await?;
        }
        let excludes = |name: &str| match self.kind {
            Kind::Shared => name.ends_with(EXCLUSIVE),
            Kind::Exclusive => name != self.name,
        };
        let leases = self.leases(bucket).await?;
        match leases.into_iter().find(|lease| excludes(&lease.name)) {
            None => Ok(()),
            Some(other) => Err(self.busy(bucket, &other.name).await?),
        }
    }

    fn bytes(&self) -> Bytes {
        Bytes::from(self.holder.clone())
    }

    /// Removes the lease of a program that has ended without a word.
    async fn take_over(&self, bucket: &Bucket) -> Result<(), RemoteError> {
        let leases = self.leases(bucket).await?;
        match leases.into_iter().find(|lease| lease.name == self.name) {
            Some(lease) => Err(self.busy(bucket, &lease.name).await?),
            None => bucket.remove(&self.name).await,
        }
    }

    /// Returns the leases that have not ended.
    async fn leases(&self, bucket: &Bucket) -> Result<Vec<StoredObject>, RemoteError> {
        let now = self.now(bucket).await?;
        let mut leases = bucket.list(names::LEASES).await?;
        leases.retain(|lease| !lease.name.contains(CLOCK) && age(now, lease.modified) < ENDS_AFTER);
        Ok(leases)
    }

    /// Returns the time of the server: that of an object which is written for it.
    pub(crate) async fn now(&self, bucket: &Bucket) -> Result<SystemTime, RemoteError> {
        bucket.put(&self.clock, Bytes::new()).await?;
        let clock = bucket.find(&self.clock).await?;
        bucket.remove(&self.clock).await?;
        let gone = || bucket.damaged(&self.clock, "it is gone as soon as it is written");
        Ok(clock.ok_or_else(gone)?.modified)
    }

    /// Removes what programs left that have ended without a word.
    pub(crate) async fn sweep(bucket: &Bucket, now: SystemTime) -> Result<(), RemoteError> {
        for lease in bucket.list(names::LEASES).await? {
            if age(now, lease.modified) >= ENDS_AFTER {
                bucket.remove(&lease.name).await?;
            }
        }
        Ok(())
    }

    async fn busy(&self, bucket: &Bucket, name: &str) -> Result<RemoteError, RemoteError> {
        let holder = bucket.get(name).await?;
        Ok(RemoteError::Busy {
            place: bucket.place.clone(),
            holder: holder.map_or_else(
                || "another program".to_owned(),
                |holder| {
                    String::from_utf8_lossy(&holder)
                        .chars()
                        .take(MOST_HOLDER)
                        .collect()
                },
            ),
        })
    }

    /// Renews the lease until another program has taken it over, which is an error.
    pub(crate) async fn renew(&self, bucket: &Bucket) -> RemoteError {
        loop {
            tokio::time::sleep(RENEWED_EVERY).await;
            match self.renew_once(bucket).await {
                Ok(()) => {}
                Err(error) => return error,
            }
        }
    }

    async fn renew_once(&self, bucket: &Bucket) -> Result<(), RemoteError> {
        if self.is_own(bucket).await? {
            bucket.put(&self.name, self.bytes()).await
        } else {
            Err(self.busy(bucket, &self.name).await?)
        }
    }

    /// Returns whether the lease exists and belongs to this program.
    async fn is_own(&self, bucket: &Bucket) -> Result<bool, RemoteError> {
        let holder = bucket.get(&self.name).await?;
        Ok(holder.is_some_and(|holder| holder == self.holder.as_bytes()))
    }

    /// Ends the lease, whether it was taken or only asked for.
    pub(crate) async fn release(&self, bucket: &Bucket) -> Result<(), RemoteError> {
        bucket.remove(&self.clock).await?;
        if self.is_own(bucket).await? {
            bucket.remove(&self.name).await
        } else {
            Ok(())
        }
    }
}

/// Returns the time from `then` to `now`, or zero if the clock was set back.
pub(crate) fn age(now: SystemTime, then: SystemTime) -> Duration {
    now.duration_since(then).unwrap_or_default()
}

/// Returns a unique, readable name of this program.
fn holder() -> String {
    let since = SystemTime::now()
        .duration_since(SystemTime::UNIX_EPOCH)
        .unwrap_or_default();
    let opened = OPENED.fetch_add(1, Ordering::Relaxed);
    format!(
        "marf (process {}, {}-{opened})",
        std::process::id(),
        since.as_nanos()
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{address::Patience, threads::Threads, trust::Trust};

    #[test]
    fn a_lease_that_was_taken_over_ends_the_work_and_stays_with_its_new_holder() {
        let dir = tempfile::tempdir().unwrap();
        let url = format!("file://{}", dir.path().display());
        let bucket = Bucket::open(&url, Patience::Patient, Trust::default()).unwrap();
        Threads::new().unwrap().block_on(async {
            let lease = Lease::new(Kind::Exclusive);
            lease.take(&bucket).await.unwrap();
            lease.renew_once(&bucket).await.unwrap();
            let other = "another marf".repeat(1_000);
            bucket.put(&lease.name, Bytes::from(other.clone())).await.unwrap();
            let lost = lease.renew_once(&bucket).await.unwrap_err();
            assert!(
                matches!(&lost, RemoteError::Busy { holder, .. } if *holder == other[..MOST_HOLDER]),
                "{lost}"
            );
            lease.release(&bucket).await.unwrap();
            assert_eq!(bucket.get(&lease.name).await.unwrap().unwrap(), other);
            // One that was removed is lost, too.
            bucket.remove(&lease.name).await.unwrap();
            let lost = lease.renew_once(&bucket).await.unwrap_err();
            assert!(matches!(lost, RemoteError::Busy { .. }), "{lost}");
        });
    }
}
