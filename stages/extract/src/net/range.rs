//! Continuing a body: its validators, and whether an answer is its rest.

use super::Validators;

/// Longest validator that is kept.
const MAX_VALIDATOR_BYTES: usize = 256;

/// Returns a validator as a host sent it, if it can be sent back.
pub(super) fn validator(value: Option<&str>) -> Option<String> {
    let value = value?.trim();
    let plain = value.bytes().all(|byte| byte == b' ' || byte.is_ascii_graphic());
    (plain && !value.is_empty() && value.len() <= MAX_VALIDATOR_BYTES).then(|| value.to_owned())
}

/// Returns the value for `If-Range`: a strong `ETag`, else a `Last-Modified` that is a date.
pub(super) fn if_range(validators: &Validators) -> Option<&str> {
    let strong = |etag: &&str| etag.len() >= 2 && etag.starts_with('"') && etag.ends_with('"');
    let dated = |text: &&str| httpdate::parse_http_date(text).is_ok();
    let etag = validators.etag.as_deref().filter(strong);
    etag.or_else(|| validators.modified.as_deref().filter(dated))
}

/// Whether the answer is of another version than the kept one. A validator that either side lacks is not compared.
pub(super) fn differs(kept: &Validators, answer: &Validators) -> bool {
    let other = |a: &Option<String>, b: &Option<String>| a.is_some() && b.is_some() && a != b;
    other(&kept.etag, &answer.etag) || other(&kept.modified, &answer.modified)
}

/// Reads `Content-Range: bytes FIRST-LAST/TOTAL` and returns TOTAL, if it is the rest from `from` to the end.
///
/// # Errors
/// Another start, another total than `length`, an end before the end, no total, no such text: says what came.
pub(super) fn rest(value: Option<&str>, from: u64, length: Option<u64>) -> Result<u64, String> {
    let value = value.ok_or("no Content-Range")?;
    let shown = || super::origin::cut(value);
    let range = ContentRange::parse(value).ok_or_else(|| format!("Content-Range `{}`", shown()))?;
    let ContentRange { first, last, total } = range;
    if first != from || last.checked_add(1) != Some(total) || first > last {
        return Err(format!("Content-Range `{}`, asked from {from}", shown()));
    }
    if let Some(length) = length.filter(|length| *length != total) {
        return Err(format!("{total} bytes in all, {length} when it began"));
    }
    Ok(total)
}

/// The numbers of a header `Content-Range`, in bytes.
struct ContentRange {
    first: u64,
    last: u64,
    total: u64,
}

impl ContentRange {
    fn parse(value: &str) -> Option<Self> {
        let number = |text: &str| -> Option<u64> {
            let digits = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
            digits.then(|| text.parse().ok()).flatten()
        };
        let (unit, rest) = value.trim().split_once(' ')?;
        let (span, total) = rest.trim().split_once('/')?;
        let (first, last) = span.split_once('-')?;
        let range = Self {
            first: number(first)?,
            last: number(last)?,
            total: number(total)?,
        };
        unit.eq_ignore_ascii_case("bytes").then_some(range)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn validators(etag: &str, modified: &str) -> Validators {
        let some = |text: &str| (!text.is_empty()).then(|| text.to_owned());
        Validators {
            etag: some(etag),
            modified: some(modified),
        }
    }

    #[test]
    fn only_strong_validators_continue_a_body() {
        const DATE: &str = "Sun, 06 Nov 1994 08:49:37 GMT";
        for (etag, modified, expected) in [
            ("\"a-1\"", DATE, Some("\"a-1\"")),
            ("W/\"a-1\"", DATE, Some(DATE)),
            ("W/\"a-1\"", "", None),
            ("a-1", "", None),
            ("\"", "", None),
            ("", DATE, Some(DATE)),
            ("", "yesterday", None),
            ("", "", None),
        ] {
            assert_eq!(
                if_range(&validators(etag, modified)),
                expected,
                "{etag} {modified}"
            );
        }
    }

    #[test]
    fn validators_that_cannot_be_sent_back_are_dropped() {
        for bad in ["", "a\r\nX: y", "é", &"x".repeat(257)] {
            assert_eq!(validator(Some(bad)), None, "{bad:?}");
        }
        assert_eq!(validator(Some(" \"x\" ")).as_deref(), Some("\"x\""));
    }

    #[test]
    fn versions_differ_by_what_both_sides_say() {
        let kept = validators("\"a\"", "");
        assert!(differs(&kept, &validators("\"b\"", "")));
        for same in [
            validators("\"a\"", ""),
            validators("", "x"),
            Validators::default(),
        ] {
            assert!(!differs(&kept, &same), "{same:?}");
        }
    }

    #[test]
    fn a_rest_begins_where_the_part_ends_and_reaches_the_end() {
        assert_eq!(rest(Some("bytes 10-99/100"), 10, Some(100)), Ok(100));
        assert_eq!(rest(Some("Bytes 10-99/100"), 10, None), Ok(100));
        for bad in [
            None,
            Some(""),
            Some("bytes"),
            Some("bytes 10-99/*"),
            Some("bytes */100"),
            Some("bytes 0-99/100"),
            Some("bytes 11-99/100"),
            Some("bytes 10-98/100"),
            Some("bytes 10-100/100"),
            Some("bytes 10-9/10"),
            Some("bytes 10-109/110"),
            Some("bytes +10-99/100"),
            Some("items 10-99/100"),
            Some("bytes 10-18446744073709551615/18446744073709551616"),
            Some("bytes 10-18446744073709551615/0"),
        ] {
            assert!(rest(bad, 10, Some(100)).is_err(), "{bad:?}");
        }
    }
}
