//! Reading and writing of kept bytes: numbers, and parts behind their length.

/// Removes `N` bytes from the front. `None` if there are fewer.
pub(crate) fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (front, rest) = bytes.split_first_chunk::<N>()?;
    *bytes = rest;
    Some(*front)
}

/// Appends a number in groups of seven bits, the lowest first (LEB128): one byte below 128, ten at the most.
pub(crate) fn put_number(bytes: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
}

/// Removes a number of [`put_number`] from the front. `None` if it is cut short or above `u64::MAX`.
pub(crate) fn take_number(bytes: &mut &[u8]) -> Option<u64> {
    let mut number = 0;
    for shift in (0..u64::BITS).step_by(7) {
        let [byte] = take(bytes)?;
        let part = u64::from(byte & 0x7f);
        if part > u64::MAX >> shift {
            return None;
        }
        number |= part << shift;
        if byte < 0x80 {
            return Some(number);
        }
    }
    None
}

/// Appends bytes behind their number.
pub(crate) fn put_part(bytes: &mut Vec<u8>, part: &[u8]) {
    put_number(bytes, part.len() as u64);
    bytes.extend(part);
}

/// Removes a part of [`put_part`] from the front. `None` if it is cut short.
pub(crate) fn take_part<'a>(bytes: &mut &'a [u8]) -> Option<&'a [u8]> {
    let length = usize::try_from(take_number(bytes)?).ok()?;
    let (part, rest) = bytes.split_at_checked(length)?;
    *bytes = rest;
    Some(part)
}

/// Appends a text that may be absent.
pub(crate) fn put_text(bytes: &mut Vec<u8>, text: Option<&str>) {
    bytes.push(u8::from(text.is_some()));
    if let Some(text) = text {
        put_part(bytes, text.as_bytes());
    }
}

/// Removes a text of [`put_text`] from the front. The outer `None` if it is cut short or not a text.
pub(crate) fn take_text<'a>(bytes: &mut &'a [u8]) -> Option<Option<&'a str>> {
    match take(bytes)? {
        [0] => Some(None),
        [1] => Some(Some(std::str::from_utf8(take_part(bytes)?).ok()?)),
        _ => None,
    }
}

/// A value that is kept as bytes and may borrow them.
pub trait Stored<'a>: Sized {
    /// Returns the value as bytes, the same on every machine.
    fn encode(&self) -> Vec<u8>;

    /// Reads the bytes of [`Stored::encode`]. `None` for other bytes.
    fn decode(bytes: &'a [u8]) -> Option<Self>;
}

/// Nothing: no bytes.
impl Stored<'_> for () {
    fn encode(&self) -> Vec<u8> {
        Vec::new()
    }

    fn decode(bytes: &[u8]) -> Option<Self> {
        bytes.is_empty().then_some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: 300 is 0b10_0101100.
    #[test]
    fn numbers_come_back_and_small_ones_take_one_byte() {
        for (number, written) in [(0, &[0][..]), (127, &[127]), (300, &[0xac, 2])] {
            let mut bytes = Vec::new();
            put_number(&mut bytes, number);
            assert_eq!(bytes, written);
        }
        for number in [0, 1, 127, 128, 16_383, 16_384, u64::MAX - 1, u64::MAX] {
            let mut bytes = Vec::new();
            put_number(&mut bytes, number);
            bytes.push(9);
            let mut rest = bytes.as_slice();
            assert_eq!((take_number(&mut rest), rest), (Some(number), &[9][..]));
            assert_eq!(take_number(&mut &bytes[..bytes.len() - 2]), None, "{number} cut");
        }
        assert_eq!(take_number(&mut &[0xff; 10][..]), None, "above u64::MAX");
    }

    #[test]
    fn texts_come_back_and_an_empty_one_is_not_an_absent_one() {
        for text in [None, Some(""), Some("ZL0 é")] {
            let mut bytes = Vec::new();
            put_text(&mut bytes, text);
            assert_eq!(take_text(&mut bytes.as_slice()), Some(text));
            assert_eq!(take_text(&mut &bytes[..bytes.len() - 1]), None, "{text:?} cut");
        }
        assert_eq!(take_text(&mut &[1, 1, 0xff][..]), None, "no UTF-8");
    }
}
