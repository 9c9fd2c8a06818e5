//! Place and size of the difference of two contents.

use marf_engine::{Change, changes};
use serde::Serialize;
use serde_json::Value;

/// Difference of two contents.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// Lengths, bytes.
    pub bytes: (u64, u64),
    /// The first byte that differs, counted from 0, or the length of the shorter one if the other continues.
    pub first_byte: u64,
    /// Bytes that differ, and those that only one of them has.
    pub differing_bytes: u64,
    /// Of two JSON documents the values that differ, by path.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub values: Vec<Change>,
}

/// Returns how two contents differ. `None` if they are equal.
pub fn difference(one: &[u8], two: &[u8]) -> Option<Difference> {
    let first = one.iter().zip(two).position(|(a, b)| a != b);
    if first.is_none() && one.len() == two.len() {
        return None;
    }
    let shorter = one.len().min(two.len());
    let differing = one.iter().zip(two).filter(|(a, b)| a != b).count();
    Some(Difference {
        bytes: (one.len() as u64, two.len() as u64),
        first_byte: first.unwrap_or(shorter) as u64,
        differing_bytes: (differing + one.len().max(two.len()) - shorter) as u64,
        values: values(one, two),
    })
}

/// Returns the values that differ between two JSON documents. Empty for other contents.
pub fn values(one: &[u8], two: &[u8]) -> Vec<Change> {
    let parse = |bytes: &[u8]| serde_json::from_slice::<Value>(bytes).ok();
    match (parse(one), parse(two)) {
        (Some(one), Some(two)) => changes(&one, &two),
        _ => Vec::new(),
    }
}

/// Returns a value that differs as words: path, old and new value. Paths of documents mean nothing but themselves, unlike those of
/// actions, which [`Change`] has sentences for.
pub fn value_text(value: &Change) -> String {
    let told = |value: &Option<String>| value.clone().unwrap_or_else(|| "absent".to_owned());
    format!("{}: {} -> {}", value.path, told(&value.old), told(&value.new))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_contents_do_not_differ_and_others_differ_somewhere() {
        assert_eq!(difference(b"abc", b"abc"), None);
        let changed = difference(b"abcd", b"axcx").unwrap();
        assert_eq!((changed.first_byte, changed.differing_bytes), (1, 2));
        let longer = difference(b"ab", b"abcd").unwrap();
        assert_eq!(
            (longer.first_byte, longer.differing_bytes, longer.bytes),
            (2, 2, (2, 4))
        );
        assert_eq!(difference(b"", b"").map(|found| found.first_byte), None);
    }

    #[test]
    fn documents_differ_in_values() {
        let found = difference(
            br#"{"psnr": 20.5, "views": [1, 2]}"#,
            br#"{"psnr": 21, "views": [1, 3], "files": {"b": 1}}"#,
        )
        .unwrap();
        let words: Vec<String> = found.values.iter().map(value_text).collect();
        assert_eq!(
            words,
            ["files.b: absent -> 1", "psnr: 20.5 -> 21", "views.1: 2 -> 3"]
        );
        assert_eq!(difference(b"[1", b"[2").unwrap().values, []);
    }
}
