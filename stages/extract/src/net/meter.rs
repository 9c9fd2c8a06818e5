//! Bytes and rate as a short note for a progress bar, which has the remaining time.

use std::collections::VecDeque;
use std::time::Duration;

use marf_stage::format;

/// Span over which the rate is taken.
const WINDOW: Duration = Duration::from_secs(20);

/// Measures the rate of downloads. The caller passes the time.
#[derive(Debug)]
pub(crate) struct Meter {
    seen: VecDeque<Seen>,
}

#[derive(Debug, Clone, Copy)]
struct Seen {
    at: Duration,
    bytes: u64,
}

impl Meter {
    /// Begins at time 0.
    pub(crate) fn new() -> Self {
        let begin = Seen {
            at: Duration::ZERO,
            bytes: 0,
        };
        Self {
            seen: VecDeque::from([begin]),
        }
    }

    /// Returns the note when `bytes` have come by `at`, since the beginning, as `84.0 MB, 3.1 MB/s`.
    pub(crate) fn note(&mut self, at: Duration, bytes: u64) -> String {
        self.seen.push_back(Seen { at, bytes });
        // The first one stays the youngest that is at least a window old.
        while self
            .seen
            .get(1)
            .is_some_and(|second| at.saturating_sub(second.at) >= WINDOW)
        {
            self.seen.pop_front();
        }
        let first = self.seen.front().copied();
        let mut note = format::size(bytes);
        let span = first.map_or(Duration::ZERO, |first| at.saturating_sub(first.at));
        if let (Some(first), false) = (first, span.is_zero()) {
            let rate = bytes.saturating_sub(first.bytes) as f64 / span.as_secs_f64();
            note.push_str(&format!(", {}/s", format::size(rate as u64)));
        }
        note
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_note_tells_bytes_and_rate() {
        let seconds = Duration::from_secs;
        let mut meter = Meter::new();
        assert_eq!(meter.note(Duration::ZERO, 0), "0 bytes");
        assert_eq!(meter.note(seconds(1), 500_000), "500.0 KB, 500.0 KB/s");
        assert_eq!(meter.note(seconds(10), 31_000_000), "31.0 MB, 3.1 MB/s");
        assert_eq!(meter.note(seconds(40), 31_000_000), "31.0 MB, 0 bytes/s");
    }

    #[test]
    fn the_rate_is_of_the_last_window() {
        let mut meter = Meter::new();
        for second in 0..=100 {
            let bytes = if second <= 50 {
                0
            } else {
                (second - 50) * 2_000_000
            };
            let note = meter.note(Duration::from_secs(second), bytes);
            assert!(second < 80 || note.ends_with(", 2.0 MB/s"), "{second}: {note}");
        }
        assert!(meter.seen.len() < 30, "{}", meter.seen.len());
    }

    #[test]
    fn numbers_that_run_backwards_are_no_panic() {
        let mut meter = Meter::new();
        meter.note(Duration::from_secs(9), 9);
        meter.note(Duration::from_secs(1), 1);
        assert_eq!(meter.note(Duration::MAX, u64::MAX), "18446744.1 TB, 1 byte/s");
    }
}
