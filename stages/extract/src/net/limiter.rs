//! Limits of one host: how many requests at once, how far apart, and when no more are sent.

use std::collections::BTreeMap;
use std::sync::{Arc, Weak};
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::{Semaphore, SemaphorePermit};
use tokio::time::{Instant, sleep_until};

use super::backoff::LONGEST_RETRY_AFTER;
use super::error::NetErrorKind;
use super::origin::Origin;

/// Answers 403 in a row after which a host is asked no more.
const MOST_REFUSALS: u32 = 5;
/// Addresses in a row that failed at every try after which a host is asked no more.
const MOST_FAILURES: u32 = 5;

/// Limiters by host and settings. Two archives of one pipeline with the same settings share the limiter of a host, so
/// that the host sees no more requests of both than of one.
static SHARED: Mutex<BTreeMap<(String, usize, Duration), Weak<HostLimiter>>> = Mutex::new(BTreeMap::new());

/// The limiters of the hosts that a client has asked. A pause that a host asked for lasts as long as such a client.
#[derive(Debug)]
pub(super) struct HostLimiters {
    per_host: usize,
    delay: Duration,
    hosts: Mutex<BTreeMap<String, Arc<HostLimiter>>>,
}

impl HostLimiters {
    pub(super) fn new(per_host: usize, delay: Duration) -> Self {
        Self {
            per_host: per_host.clamp(1, Semaphore::MAX_PERMITS),
            delay,
            hosts: Mutex::default(),
        }
    }

    /// The limiter of an origin's host and port.
    pub(super) fn limiter(&self, origin: &Origin) -> Arc<HostLimiter> {
        let name = origin.authority();
        let mut hosts = self.hosts.lock();
        let limiter = hosts.entry(name).or_insert_with_key(|name| self.shared(name));
        Arc::clone(limiter)
    }

    fn shared(&self, name: &str) -> Arc<HostLimiter> {
        let mut shared = SHARED.lock();
        let limiter = shared
            .entry((name.to_owned(), self.per_host, self.delay))
            .or_default();
        limiter.upgrade().unwrap_or_else(|| {
            let fresh = Arc::new(HostLimiter {
                name: name.to_owned(),
                delay: self.delay,
                slots: Semaphore::new(self.per_host),
                state: Mutex::default(),
            });
            *limiter = Arc::downgrade(&fresh);
            fresh
        })
    }
}

/// The limiter of one host.
#[derive(Debug)]
pub(super) struct HostLimiter {
    name: String,
    delay: Duration,
    slots: Semaphore,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    /// No request starts before it.
    next: Option<Instant>,
    /// 403 in a row.
    refusals: u32,
    /// Addresses given up in a row.
    failures: u32,
    /// Why the host is asked no more.
    stopped: Option<String>,
}

impl HostLimiter {
    /// Waits until a request may start: for a free connection, and for the delay since the last start. The connection
    /// is free again when the permit is dropped.
    ///
    /// # Errors
    /// The host is asked no more, or has asked for a wait that is too long.
    pub(super) async fn enter(&self) -> Result<SemaphorePermit<'_>, NetErrorKind> {
        let permit = self.slots.acquire().await.map_err(|_| NetErrorKind::Lost)?;
        loop {
            match self.start()? {
                None => return Ok(permit),
                Some(at) => sleep_until(at).await,
            }
        }
    }

    /// Starts a request now, or returns when one may start.
    fn start(&self) -> Result<Option<Instant>, NetErrorKind> {
        let mut state = self.state.lock();
        if let Some(why) = &state.stopped {
            return Err(NetErrorKind::HostStopped {
                host: self.name.clone(),
                why: why.clone(),
            });
        }
        let now = Instant::now();
        if let Some(next) = state.next.filter(|next| *next > now) {
            let wait = next - now;
            if wait > LONGEST_RETRY_AFTER.max(self.delay) {
                return Err(NetErrorKind::Later { wait });
            }
            return Ok(Some(next));
        }
        state.next = now.checked_add(self.delay);
        Ok(None)
    }

    /// Starts no request before the end of a pause that the host asked for.
    pub(super) fn pause(&self, wait: Duration) {
        // At most a year, since a clock may not hold more.
        let wait = wait.min(Duration::from_secs(365 * 86_400));
        let mut state = self.state.lock();
        state.next = state.next.max(Instant::now().checked_add(wait));
    }

    /// Counts an answer 403.
    pub(super) fn refused(&self) {
        let mut state = self.state.lock();
        state.refusals += 1;
        if state.refusals >= MOST_REFUSALS {
            let why = format!("it answered 403 {MOST_REFUSALS} times in a row, as a firewall does");
            state.stopped.get_or_insert(why);
        }
    }

    /// Sets the counts of failures back: the host answered.
    pub(super) fn answered(&self) {
        let mut state = self.state.lock();
        (state.refusals, state.failures) = (0, 0);
    }

    /// Counts an address that was given up after all its tries.
    pub(super) fn failed(&self, kind: &NetErrorKind) {
        let mut state = self.state.lock();
        state.failures += 1;
        if state.failures >= MOST_FAILURES {
            let why = format!("{MOST_FAILURES} addresses in a row failed at every try, the last one: {kind}");
            state.stopped.get_or_insert(why);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limiter(host: &str, delay: Duration) -> Arc<HostLimiter> {
        HostLimiters::new(2, delay).limiter(&Origin::parse(&format!("https://{host}")).unwrap())
    }

    #[test]
    fn two_clients_with_the_same_settings_share_a_host() {
        let (one, other) = (
            limiter("shared.example", Duration::ZERO),
            limiter("shared.example", Duration::ZERO),
        );
        assert!(Arc::ptr_eq(&one, &other));
        assert!(!Arc::ptr_eq(
            &one,
            &limiter("shared.example", Duration::from_secs(1))
        ));
        (0..MOST_REFUSALS).for_each(|_| one.refused());
        assert!(other.start().is_err());
        drop((one, other));
        assert!(
            limiter("shared.example", Duration::ZERO).start().is_ok(),
            "forgotten with the last client"
        );
    }

    #[test]
    fn a_burst_of_403_stops_the_host_and_says_so() {
        let limiter = limiter("a.example", Duration::ZERO);
        (0..4).for_each(|_| limiter.refused());
        limiter.answered();
        (0..4).for_each(|_| limiter.refused());
        assert_eq!(limiter.start(), Ok(None));
        limiter.refused();
        let text = limiter.start().unwrap_err().to_string();
        assert!(
            text.contains("a.example:443") && text.contains("403 5 times"),
            "{text}"
        );
    }

    #[test]
    fn a_dead_host_is_stopped_and_named() {
        let limiter = limiter("b.example", Duration::ZERO);
        (0..MOST_FAILURES).for_each(|_| limiter.failed(&NetErrorKind::Status(503)));
        let text = limiter.start().unwrap_err().to_string();
        assert!(text.contains("in a row") && text.contains("503"), "{text}");
    }

    #[test]
    fn a_pause_holds_the_host_and_a_long_one_is_an_error() {
        let limiter = limiter("c.example", Duration::from_millis(250));
        assert_eq!(limiter.start(), Ok(None));
        assert!(limiter.start().unwrap().is_some(), "the delay holds");
        limiter.pause(Duration::from_secs(599));
        assert!(limiter.start().unwrap().is_some());
        limiter.pause(Duration::MAX);
        assert!(matches!(limiter.start(), Err(NetErrorKind::Later { wait }) if wait.as_secs() > 600));
    }
}
