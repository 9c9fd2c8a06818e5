//! Parts of a file: browsers ask for those of a film where somebody seeks, and some play none without.

use std::ops::Range;

/// What a request wants of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RangePart {
    /// All of it.
    Whole,
    /// A part that the file has.
    Inside(Range<usize>),
    /// A part of which the file has nothing.
    Outside,
}

/// Returns what a `Range` header requests of a file of a length: the whole without such a header, with several parts, or
/// with an invalid one (RFC 9110, section 14.2).
pub fn wanted(header: Option<&str>, length: usize) -> RangePart {
    let Some(part) = header.and_then(|header| part(header, length)) else {
        return RangePart::Whole;
    };
    let part = part.start..part.end.min(length);
    if part.is_empty() {
        return RangePart::Outside;
    }
    RangePart::Inside(part)
}

/// Returns the requested part, also outside the file.
fn part(header: &str, length: usize) -> Option<Range<usize>> {
    let (first, last) = header.strip_prefix("bytes=")?.split_once('-')?;
    if let ("", last) = (first, last) {
        return Some(length.saturating_sub(number(last)?)..length);
    }
    let first = number(first)?;
    if last.is_empty() {
        return Some(first..usize::MAX);
    }
    let last = number(last)?;
    (first <= last).then(|| first..last.saturating_add(1))
}

/// Reads a number. One that is too large is the largest.
fn number(text: &str) -> Option<usize> {
    let is_number = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    is_number.then(|| text.parse().unwrap_or(usize::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_is_within_the_file_or_outside_and_what_is_invalid_is_the_whole() {
        let part = |range| RangePart::Inside(range);
        for (header, expected) in [
            ("bytes=0-", part(0..10)),
            ("bytes=4-", part(4..10)),
            ("bytes=4-4", part(4..5)),
            ("bytes=4-99", part(4..10)),
            ("bytes=-3", part(7..10)),
            ("bytes=-99", part(0..10)),
            ("bytes=0-18446744073709551615", part(0..10)),
            ("bytes=0-99999999999999999999", part(0..10)),
            ("bytes=10-", RangePart::Outside),
            ("bytes=10-12", RangePart::Outside),
            ("bytes=99999999999999999999-", RangePart::Outside),
            ("bytes=-0", RangePart::Outside),
            ("bytes=5-4", RangePart::Whole),
            ("bytes=0-1,4-5", RangePart::Whole),
            ("bytes=x-", RangePart::Whole),
            ("bytes=+1-", RangePart::Whole),
            ("bytes=-", RangePart::Whole),
            ("lines=0-1", RangePart::Whole),
        ] {
            assert_eq!(wanted(Some(header), 10), expected, "{header}");
        }
        assert_eq!(wanted(None, 10), RangePart::Whole);
        assert_eq!(wanted(Some("bytes=0-"), 0), RangePart::Outside);
    }
}
