//! Points in time as text.

use std::time::{Duration, SystemTime};

/// 9999-12-31T23:59:59Z, the last time that has four digits for its year.
const LAST_UNIX_S: u64 = 253_402_300_799;

/// Returns a time in seconds since 1970 as `2026-11-21T07:01:02Z`, for people: 0, which a clock before 1970 leaves, as `unknown`.
pub fn iso_time(unix_s: u64) -> String {
    known_time(unix_s).unwrap_or_else(|| "unknown".to_owned())
}

/// Returns a time in seconds since 1970 as `2026-11-21T07:01:02Z`, past the year 9999 as its end. `None` for
/// 0, which is unknown.
pub(crate) fn known_time(unix_s: u64) -> Option<String> {
    let since_1970 = Duration::from_secs(unix_s.min(LAST_UNIX_S));
    let time = humantime::format_rfc3339_seconds(SystemTime::UNIX_EPOCH + since_1970);
    (unix_s > 0).then(|| time.to_string())
}

/// Returns the end of a process that began at a time and took `seconds`, in whole seconds since 1970. 0 if
/// the start is unknown.
pub(crate) fn end_of(started_unix_s: u64, seconds: f64) -> u64 {
    let end = started_unix_s.saturating_add(seconds.max(0.0) as u64);
    if started_unix_s == 0 { 0 } else { end }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_at_the_edges_of_years_and_leap_days() {
        for (unix_s, text) in [
            (0, "unknown"),
            (1, "1970-01-01T00:00:01Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (1_709_251_199, "2024-02-29T23:59:59Z"),
            (1_795_244_462, "2026-11-21T07:01:02Z"),
            (LAST_UNIX_S, "9999-12-31T23:59:59Z"),
            (u64::MAX, "9999-12-31T23:59:59Z"),
        ] {
            assert_eq!(iso_time(unix_s), text);
        }
    }

    #[test]
    fn an_end_is_a_whole_second_and_never_before_the_start() {
        assert_eq!(end_of(10, 2.9), 12);
        assert_eq!(end_of(10, -5.0), 10);
        assert_eq!(end_of(10, f64::NAN), 10);
        assert_eq!(end_of(u64::MAX, 1e300), u64::MAX);
        assert_eq!(end_of(0, 2.9), 0, "unknown");
    }
}
