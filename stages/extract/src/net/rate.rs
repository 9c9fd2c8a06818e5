//! Finds bodies that come too slowly.

use std::time::Duration;

/// Measures the mean rate of a body, window by window: a host that begins fast and then slows down is found too.
#[derive(Debug)]
pub(super) struct RateMonitor {
    window: Duration,
    slowest: u64,
    began: Duration,
    bytes: u64,
}

impl RateMonitor {
    /// Begins at time 0 of the body. `slowest` is in bytes a second over each `window`.
    pub(super) fn new(window: Duration, slowest: u64) -> Self {
        Self {
            window,
            slowest,
            began: Duration::ZERO,
            bytes: 0,
        }
    }

    /// Adds bytes that came at `now` since the body began. Returns the rate, bytes a second, if it is too slow.
    pub(super) fn came(&mut self, bytes: u64, now: Duration) -> Option<u64> {
        self.bytes += bytes;
        let span = now.saturating_sub(self.began);
        if span < self.window || span.is_zero() {
            return None;
        }
        let rate = (self.bytes as f64 / span.as_secs_f64()) as u64;
        (self.began, self.bytes) = (now, 0);
        (rate < self.slowest).then_some(rate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drip_is_seen_at_the_end_of_its_window() {
        let seconds = Duration::from_secs;
        let mut pace = RateMonitor::new(seconds(60), 1_000);
        assert_eq!(pace.came(0, seconds(59)), None);
        assert_eq!(pace.came(59_000, seconds(60)), Some(983));
        let mut pace = RateMonitor::new(seconds(60), 1_000);
        assert_eq!(
            pace.came(64 << 20, seconds(60)),
            None,
            "a fast beginning gives no credit"
        );
        assert_eq!(pace.came(29, seconds(90)), None);
        assert_eq!(pace.came(29, seconds(120)), Some(0));
        let mut endless = RateMonitor::new(Duration::ZERO, 1);
        assert_eq!(endless.came(1, Duration::ZERO), None, "no division by zero");
    }
}
