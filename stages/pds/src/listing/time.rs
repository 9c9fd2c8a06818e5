//! Times of the column `Last modified`.

const MONTHS: [&[u8]; 12] = [
    b"Jan", b"Feb", b"Mar", b"Apr", b"May", b"Jun", b"Jul", b"Aug", b"Sep", b"Oct", b"Nov", b"Dec",
];

/// Finds the first `YYYY-MM-DD HH:MM` or `DD-Mon-YYYY HH:MM` in a text (seconds are dropped). Returns it as
/// `YYYY-MM-DDTHH:MM`.
pub(super) fn find(text: &[u8]) -> Option<String> {
    let mut words = text
        .split(u8::is_ascii_whitespace)
        .filter(|word| !word.is_empty())
        .peekable();
    while let Some(word) = words.next() {
        let found = date(word).zip(words.peek().copied().and_then(clock));
        if let Some(((year, month, day), (hour, minute))) = found {
            return Some(format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}"));
        }
    }
    None
}

fn date(word: &[u8]) -> Option<(u32, u32, u32)> {
    let mut parts = word.splitn(4, |byte| *byte == b'-');
    let (first, middle, last) = (parts.next()?, parts.next()?, parts.next()?);
    let found = match (first.len(), parts.next()) {
        (4, None) => (digits(first, 4)?, digits(middle, 2)?, digits(last, 2)?),
        (2, None) => {
            let month = MONTHS
                .iter()
                .position(|month| month.eq_ignore_ascii_case(middle))?;
            (digits(last, 4)?, month as u32 + 1, digits(first, 2)?)
        }
        _ => return None,
    };
    ((1..=12).contains(&found.1) && (1..=31).contains(&found.2)).then_some(found)
}

fn clock(word: &[u8]) -> Option<(u32, u32)> {
    let mut parts = word.splitn(4, |byte| *byte == b':');
    let (hour, minute) = (digits(parts.next()?, 2)?, digits(parts.next()?, 2)?);
    let seconds = parts.next().is_none_or(|seconds| digits(seconds, 2).is_some());
    (hour < 24 && minute < 60 && seconds && parts.next().is_none()).then_some((hour, minute))
}

/// Reads exactly this many digits.
fn digits(word: &[u8], length: usize) -> Option<u32> {
    let whole = word.len() == length && word.iter().all(u8::is_ascii_digit);
    whole.then(|| {
        word.iter()
            .fold(0, |value, digit| 10 * value + u32::from(digit - b'0'))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_become_one() {
        for text in [
            "2022-03-01 10:20",
            "  01-Mar-2022 10:20   3.1M\n",
            "x 2022-03-01  10:20:59 -",
            "01-MAR-2022 10:20",
            "1-2-3 2022-03-01 10:20 2023-01-01 00:00",
        ] {
            assert_eq!(
                find(text.as_bytes()).as_deref(),
                Some("2022-03-01T10:20"),
                "{text}"
            );
        }
    }

    #[test]
    fn what_is_no_time_is_none() {
        for text in [
            "",
            "-",
            "&nbsp;",
            "2022-03-01",
            "10:20",
            "2022-13-01 10:20",
            "2022-03-32 10:20",
            "2022-03-01 24:00",
            "2022-03-01 10:60",
            "01-Foo-2022 10:20",
            "22-03-01 10:20",
            "2022-03-01-04 10:20",
            "2022-03-01 10:20:1",
            "+022-03-01 10:20",
            "2022-03-01 1:20",
        ] {
            assert_eq!(find(text.as_bytes()), None, "{text}");
        }
    }
}
