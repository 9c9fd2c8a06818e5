//! Bytes, rate and remaining time as a short note for a progress bar.

use std::collections::VecDeque;
use std::time::Duration;

/// Span over which the rate is taken.
const WINDOW: Duration = Duration::from_secs(20);
/// Time after which the remaining time is estimated.
const FIRST_GUESS: Duration = Duration::from_secs(3);

/// Measures the rate of downloads. The caller passes the time.
#[derive(Debug)]
pub(crate) struct Meter {
    total: u64,
    seen: VecDeque<Seen>,
}

#[derive(Debug, Clone, Copy)]
struct Seen {
    at: Duration,
    bytes: u64,
}

impl Meter {
    /// Begins at time 0 with `total` files to download.
    pub(crate) fn new(total: u64) -> Self {
        let begin = Seen {
            at: Duration::ZERO,
            bytes: 0,
        };
        Self {
            total,
            seen: VecDeque::from([begin]),
        }
    }

    /// Returns the note when `done` files and `bytes` have come by `at`, since the beginning, as
    /// `84 MB, 3.1 MB/s, 4 min left`. The estimate counts files, since no archive announces bytes.
    pub(crate) fn note(&mut self, at: Duration, done: u64, bytes: u64) -> String {
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
        let mut note = size(bytes as f64);
        let span = first.map_or(Duration::ZERO, |first| at.saturating_sub(first.at));
        if let (Some(first), false) = (first, span.is_zero()) {
            let rate = bytes.saturating_sub(first.bytes) as f64 / span.as_secs_f64();
            note.push_str(&format!(", {}/s", size(rate)));
        }
        if let Some(left) = self.left(at, done) {
            note.push_str(&format!(", {} left", time(left)));
        }
        note
    }

    /// Returns the time that the rest takes at the mean rate so far.
    fn left(&self, at: Duration, done: u64) -> Option<Duration> {
        let rest = self.total.saturating_sub(done);
        if done == 0 || rest == 0 || at < FIRST_GUESS {
            return None;
        }
        let seconds = at.as_secs_f64() * rest as f64 / done as f64;
        Duration::try_from_secs_f64(seconds).ok()
    }
}

/// Returns bytes in decimal units, two to three digits.
fn size(bytes: f64) -> String {
    let units = ["B", "kB", "MB", "GB", "TB"];
    let mut value = bytes;
    let mut unit = 0;
    while value >= 999.5 && unit + 1 < units.len() {
        value /= 1_000.0;
        unit += 1;
    }
    if value < 9.95 && unit > 0 {
        format!("{value:.1} {}", units[unit])
    } else {
        format!("{value:.0} {}", units[unit])
    }
}

fn time(left: Duration) -> String {
    let seconds = left.as_secs();
    match seconds {
        0..=89 => format!("{} s", seconds.max(1)),
        90..=5_399 => format!("{} min", (seconds + 30) / 60),
        5_400..=172_799 => format!("{} h", (seconds + 1_800) / 3_600),
        _ => format!("{} days", (seconds + 43_200) / 86_400),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_note_tells_bytes_rate_and_rest() {
        let seconds = Duration::from_secs;
        let mut meter = Meter::new(100);
        assert_eq!(meter.note(Duration::ZERO, 0, 0), "0 B");
        assert_eq!(meter.note(seconds(1), 1, 500_000), "500 kB, 500 kB/s");
        assert_eq!(
            meter.note(seconds(10), 4, 31_000_000),
            "31 MB, 3.1 MB/s, 4 min left"
        );
        assert_eq!(meter.note(seconds(40), 100, 31_000_000), "31 MB, 0 B/s");
    }

    #[test]
    fn the_rate_is_of_the_last_window() {
        let mut meter = Meter::new(1_000);
        for second in 0..=100 {
            let bytes = if second <= 50 {
                0
            } else {
                (second - 50) * 2_000_000
            };
            let note = meter.note(Duration::from_secs(second), second, bytes);
            assert!(second < 80 || note.contains(", 2.0 MB/s, "), "{second}: {note}");
        }
        assert!(meter.seen.len() < 30, "{}", meter.seen.len());
    }

    #[test]
    fn sizes_and_times_are_short_at_every_scale() {
        for (bytes, text) in [
            (0.0, "0 B"),
            (999.0, "999 B"),
            (999.6, "1.0 kB"),
            (9_960.0, "10 kB"),
            (84e6, "84 MB"),
            (1.5e9, "1.5 GB"),
            (2e18, "2000000 TB"),
        ] {
            assert_eq!(size(bytes), text);
        }
        for (seconds, text) in [
            (0, "1 s"),
            (89, "89 s"),
            (90, "2 min"),
            (5_400, "2 h"),
            (172_800, "2 days"),
        ] {
            assert_eq!(time(Duration::from_secs(seconds)), text);
        }
    }

    #[test]
    fn numbers_that_run_backwards_are_no_panic() {
        let mut meter = Meter::new(0);
        meter.note(Duration::from_secs(9), 9, 9);
        meter.note(Duration::from_secs(1), 3, 1);
        assert_eq!(
            meter.note(Duration::MAX, u64::MAX, u64::MAX),
            "18446744 TB, 1 B/s"
        );
    }
}
