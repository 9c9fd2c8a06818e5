//! Parts of a file: browsers ask for those of a film where somebody seeks, and some play none without.

use std::ops::Range;

/// Returns the part that a `Range` header requests, of a file of a length. `None` if the whole is to be sent:
/// without such a header, with several parts, or with an unknown form.
pub fn part(header: Option<&str>, length: usize) -> Option<Range<usize>> {
    let (first, last) = header?.strip_prefix("bytes=")?.split_once('-')?;
    let number = |text: &str| text.parse::<usize>().ok();
    let part = match (first, last) {
        ("", last) => length.saturating_sub(number(last)?)..length,
        (first, "") => number(first)?..length,
        (first, last) => number(first)?..number(last)?.checked_add(1)?.min(length),
    };
    (part.start < part.end).then_some(part)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_is_within_the_file_or_the_whole_is_sent() {
        for (header, expected) in [
            ("bytes=0-", Some(0..10)),
            ("bytes=4-", Some(4..10)),
            ("bytes=4-4", Some(4..5)),
            ("bytes=4-99", Some(4..10)),
            ("bytes=-3", Some(7..10)),
            ("bytes=-99", Some(0..10)),
            ("bytes=10-", None),
            ("bytes=5-4", None),
            ("bytes=-0", None),
            ("bytes=0-1,4-5", None),
            ("bytes=0-18446744073709551615", None),
            ("bytes=x-", None),
            ("lines=0-1", None),
        ] {
            assert_eq!(part(Some(header), 10), expected, "{header}");
        }
        assert_eq!(part(None, 10), None);
        assert_eq!(part(Some("bytes=0-"), 0), None);
    }
}
