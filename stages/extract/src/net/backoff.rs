//! How long to wait before another try.

use std::hash::{BuildHasher, RandomState};
use std::time::{Duration, SystemTime};

use super::ClientSettings;

/// Longest `Retry-After` that is waited.
pub(super) const LONGEST_RETRY_AFTER: Duration = Duration::from_secs(600);

/// Returns the wait after the `failed`-th failed try, `failed` from 1: full jitter over `first_wait · 2^(failed − 1)`,
/// at most `longest_wait` (Brooker, "Exponential backoff and jitter").
///
/// `random` decides the share, 0 none and `u64::MAX` all. No result may depend on it.
pub(super) fn wait(settings: &ClientSettings, failed: u32, random: u64) -> Duration {
    let doublings = failed.saturating_sub(1).min(31);
    let top = settings
        .first_wait
        .saturating_mul(1 << doublings)
        .min(settings.longest_wait);
    top.mul_f64(random as f64 / u64::MAX as f64)
}

/// Returns a number that differs from call to call, for jitter alone.
pub(super) fn random() -> u64 {
    RandomState::new().hash_one(0_u8)
}

/// Reads `Retry-After`: seconds, or an HTTP date. A date is compared with the answer's own `Date` (`now` if it has
/// none), so that a wrong clock on either side does not matter. A past date means no wait.
pub(super) fn retry_after(value: &str, date: Option<&str>, now: SystemTime) -> Option<Duration> {
    let value = value.trim();
    if !value.is_empty() && value.bytes().all(|byte| byte.is_ascii_digit()) {
        // More digits than fit are longer than anything that is waited.
        return Some(Duration::from_secs(value.parse().unwrap_or(u64::MAX)));
    }
    let until = httpdate::parse_http_date(value).ok()?;
    let now = date
        .and_then(|date| httpdate::parse_http_date(date).ok())
        .unwrap_or(now);
    Some(until.duration_since(now).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> ClientSettings {
        ClientSettings::polite(Vec::new(), None)
    }

    #[test]
    fn waits_double_up_to_the_longest() {
        let seconds = |failed| wait(&settings(), failed, u64::MAX).as_secs_f64();
        for (failed, top) in [
            (0, 1.0),
            (1, 1.0),
            (2, 2.0),
            (5, 16.0),
            (6, 32.0),
            (7, 60.0),
            (u32::MAX, 60.0),
        ] {
            assert_eq!(seconds(failed), top, "{failed}");
        }
    }

    #[test]
    fn jitter_is_full() {
        assert_eq!(wait(&settings(), 3, 0), Duration::ZERO);
        let half = wait(&settings(), 3, u64::MAX / 2).as_secs_f64();
        assert!((half - 2.0).abs() < 1e-9, "{half}");
        let draws: std::collections::BTreeSet<u64> = (0..16).map(|_| random()).collect();
        assert!(draws.len() > 1, "{draws:?}");
    }

    #[test]
    fn retry_after_reads_seconds_and_dates() {
        let now = SystemTime::UNIX_EPOCH + Duration::from_secs(784_111_777);
        let (at, later) = ("Sun, 06 Nov 1994 08:49:37 GMT", "Sun, 06 Nov 1994 08:51:37 GMT");
        let earlier = "Sun, 06 Nov 1994 08:49:07 GMT";
        for (value, date, expected) in [
            ("120", None, Some(120)),
            (" 0 ", None, Some(0)),
            ("99999999999999999999999", None, Some(u64::MAX)),
            (later, None, Some(120)),
            (later, Some(earlier), Some(150)),
            (later, Some("nonsense"), Some(120)),
            (at, None, Some(0)),
            (earlier, None, Some(0)),
            ("-5", None, None),
            ("1.5", None, None),
            ("", None, None),
            ("soon", None, None),
        ] {
            let read = retry_after(value, date, now).map(|wait| wait.as_secs());
            assert_eq!(read, expected, "{value:?} {date:?}");
        }
    }
}
