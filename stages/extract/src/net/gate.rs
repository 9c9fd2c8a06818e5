//! One host: how many requests at once, how far apart, and when it is left alone.

use std::collections::BTreeMap;
use std::sync::{Arc, Weak};
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::{Semaphore, SemaphorePermit};
use tokio::time::{Instant, sleep_until};

use super::backoff::LONGEST_RETRY_AFTER;
use super::error::Trouble;
use super::origin::Origin;

/// Answers 403 in a row after which a host is left alone.
const MOST_REFUSALS: u32 = 5;
/// Addresses in a row that failed at every try after which a host is left alone.
const MOST_FAILURES: u32 = 5;

/// Gates by host and manners. Two archives of one pipeline that ask one host in the same manner share its gate, so that
/// the host sees no more of both than of one.
static SHARED: Mutex<BTreeMap<(String, usize, Duration), Weak<Gate>>> = Mutex::new(BTreeMap::new());

/// The gates of the hosts that a client has asked; what a host asked for lasts as long as a client that heard it.
#[derive(Debug)]
pub(super) struct Gates {
    per_host: usize,
    delay: Duration,
    hosts: Mutex<BTreeMap<String, Arc<Gate>>>,
}

impl Gates {
    pub(super) fn new(per_host: usize, delay: Duration) -> Self {
        Self {
            per_host: per_host.clamp(1, Semaphore::MAX_PERMITS),
            delay,
            hosts: Mutex::default(),
        }
    }

    /// The gate of an origin's host and port.
    pub(super) fn of(&self, origin: &Origin) -> Arc<Gate> {
        let name = origin.authority();
        let mut hosts = self.hosts.lock();
        let gate = hosts.entry(name).or_insert_with_key(|name| self.shared(name));
        Arc::clone(gate)
    }

    fn shared(&self, name: &str) -> Arc<Gate> {
        let mut shared = SHARED.lock();
        let gate = shared
            .entry((name.to_owned(), self.per_host, self.delay))
            .or_default();
        gate.upgrade().unwrap_or_else(|| {
            let fresh = Arc::new(Gate {
                name: name.to_owned(),
                delay: self.delay,
                slots: Semaphore::new(self.per_host),
                state: Mutex::default(),
            });
            *gate = Arc::downgrade(&fresh);
            fresh
        })
    }
}

/// The gate of one host.
#[derive(Debug)]
pub(super) struct Gate {
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
    /// Why the host is left alone.
    stopped: Option<String>,
}

impl Gate {
    /// Waits for a place and for the delay after the last start; the request starts when this returns, and its place
    /// is free when the permit is dropped.
    ///
    /// # Errors
    /// The host is left alone, or has asked for a wait that is too long.
    pub(super) async fn enter(&self) -> Result<SemaphorePermit<'_>, Trouble> {
        let permit = self.slots.acquire().await.map_err(|_| Trouble::Lost)?;
        loop {
            match self.start()? {
                None => return Ok(permit),
                Some(at) => sleep_until(at).await,
            }
        }
    }

    /// Takes the start now, or tells when to come again.
    fn start(&self) -> Result<Option<Instant>, Trouble> {
        let mut state = self.state.lock();
        if let Some(why) = &state.stopped {
            return Err(Trouble::HostStopped {
                host: self.name.clone(),
                why: why.clone(),
            });
        }
        let now = Instant::now();
        if let Some(next) = state.next.filter(|next| *next > now) {
            let wait = next - now;
            if wait > LONGEST_RETRY_AFTER.max(self.delay) {
                return Err(Trouble::Later { wait });
            }
            return Ok(Some(next));
        }
        state.next = now.checked_add(self.delay);
        Ok(None)
    }

    /// The host asked for a pause: no request starts before its end.
    pub(super) fn pause(&self, wait: Duration) {
        // A year stands for all that no clock can hold.
        let wait = wait.min(Duration::from_secs(365 * 86_400));
        let mut state = self.state.lock();
        state.next = state.next.max(Instant::now().checked_add(wait));
    }

    /// An answer 403 came.
    pub(super) fn refused(&self) {
        let mut state = self.state.lock();
        state.refusals += 1;
        if state.refusals >= MOST_REFUSALS {
            let why = format!("it answered 403 {MOST_REFUSALS} times in a row, as a firewall does");
            state.stopped.get_or_insert(why);
        }
    }

    /// An answer of use came.
    pub(super) fn answered(&self) {
        let mut state = self.state.lock();
        (state.refusals, state.failures) = (0, 0);
    }

    /// An address was given up after all its tries.
    pub(super) fn failed(&self, trouble: &Trouble) {
        let mut state = self.state.lock();
        state.failures += 1;
        if state.failures >= MOST_FAILURES {
            let why =
                format!("{MOST_FAILURES} addresses in a row failed at every try, the last one: {trouble}");
            state.stopped.get_or_insert(why);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gate(host: &str, delay: Duration) -> Arc<Gate> {
        Gates::new(2, delay).of(&Origin::parse(&format!("https://{host}")).unwrap())
    }

    #[test]
    fn two_clients_of_the_same_manners_share_a_host() {
        let (one, other) = (
            gate("shared.example", Duration::ZERO),
            gate("shared.example", Duration::ZERO),
        );
        assert!(Arc::ptr_eq(&one, &other));
        assert!(!Arc::ptr_eq(
            &one,
            &gate("shared.example", Duration::from_secs(1))
        ));
        (0..MOST_REFUSALS).for_each(|_| one.refused());
        assert!(other.start().is_err());
        drop((one, other));
        assert!(
            gate("shared.example", Duration::ZERO).start().is_ok(),
            "forgotten with the last client"
        );
    }

    #[test]
    fn a_burst_of_403_stops_the_host_and_says_so() {
        let gate = gate("a.example", Duration::ZERO);
        (0..4).for_each(|_| gate.refused());
        gate.answered();
        (0..4).for_each(|_| gate.refused());
        assert_eq!(gate.start(), Ok(None));
        gate.refused();
        let text = gate.start().unwrap_err().to_string();
        assert!(
            text.contains("a.example:443") && text.contains("403 5 times"),
            "{text}"
        );
    }

    #[test]
    fn a_dead_host_is_stopped_and_named() {
        let gate = gate("b.example", Duration::ZERO);
        (0..MOST_FAILURES).for_each(|_| gate.failed(&Trouble::Status(503)));
        let text = gate.start().unwrap_err().to_string();
        assert!(text.contains("in a row") && text.contains("503"), "{text}");
    }

    #[test]
    fn a_pause_holds_the_host_and_a_long_one_is_an_error() {
        let gate = gate("c.example", Duration::from_millis(250));
        assert_eq!(gate.start(), Ok(None));
        assert!(gate.start().unwrap().is_some(), "the delay holds");
        gate.pause(Duration::from_secs(599));
        assert!(gate.start().unwrap().is_some());
        gate.pause(Duration::MAX);
        assert!(matches!(gate.start(), Err(Trouble::Later { wait }) if wait.as_secs() > 600));
    }
}
