//! Digests of values: each value has one fixed stream of bytes, whose blake3 is its digest.
//!
//! Keys of memos, fingerprints of sols and seeds are such digests, so the stream of a value never changes. Each part begins
//! with a byte for its form. Names and lengths come before what they describe, so different contents have different streams.
//! Lengths and integers are u64 LE, ordinals u32 LE.

use std::collections::BTreeMap;

use crate::Digest;

/// A value with a digest of its content.
pub trait ContentHash {
    /// Passes the whole content of `self` to a hasher.
    fn hash_content(&self, hasher: &mut ContentHasher);
}

/// Hashes the content of values.
pub struct ContentHasher(blake3::Hasher);

/// A byte string. A `[u8]` is a list of integers.
pub struct Bytes<'a>(pub &'a [u8]);

/// Returns the digest of a value's content.
pub fn digest_of(value: &(impl ContentHash + ?Sized)) -> Digest {
    let mut hasher = ContentHasher(blake3::Hasher::new());
    value.hash_content(&mut hasher);
    Digest::from_bytes(*hasher.0.finalize().as_bytes())
}

impl ContentHasher {
    fn tagged(&mut self, tag: u8, payload: &[u8]) {
        self.0.update(&[tag]);
        self.0.update(payload);
    }

    fn sized(&mut self, tag: u8, payload: &[u8]) {
        self.tagged(tag, &(payload.len() as u64).to_le_bytes());
        self.0.update(payload);
    }

    /// Adds a struct. Its name and the names of its fields are part of the content, so they outlive a renaming in the code.
    pub fn record(&mut self, name: &str, fields: &[(&str, &dyn ContentHash)]) {
        self.sized(b'{', name.as_bytes());
        self.0.update(&(fields.len() as u64).to_le_bytes());
        for (field, value) in fields {
            self.sized(b'.', field.as_bytes());
            value.hash_content(self);
        }
        self.tagged(b'}', &[]);
    }

    /// Adds a variant of an enum by its ordinal.
    fn variant(&mut self, name: &str, ordinal: u32, fields: &[(&str, &dyn ContentHash)]) {
        self.sized(b'|', name.as_bytes());
        self.0.update(&ordinal.to_le_bytes());
        self.record(name, fields);
    }

    fn sequence<'a>(&mut self, len: usize, values: impl IntoIterator<Item = &'a dyn ContentHash>) {
        self.tagged(b'[', &(len as u64).to_le_bytes());
        values.into_iter().for_each(|value| value.hash_content(self));
        self.tagged(b'}', &[]);
    }
}

macro_rules! unsigned {
    ($($ty:ty),*) => {$(
        impl ContentHash for $ty {
            fn hash_content(&self, hasher: &mut ContentHasher) {
                hasher.tagged(b'u', &(*self as u64).to_le_bytes());
            }
        }
    )*};
}
unsigned!(u8, u32, u64, usize);

impl ContentHash for bool {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        hasher.tagged(b'b', &[u8::from(*self)]);
    }
}

impl ContentHash for str {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        hasher.sized(b's', self.as_bytes());
    }
}

impl ContentHash for String {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        self.as_str().hash_content(hasher);
    }
}

impl ContentHash for Bytes<'_> {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        hasher.sized(b'y', self.0);
    }
}

impl ContentHash for Digest {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        hasher.tagged(b'#', self.as_bytes());
    }
}

impl<T: ContentHash + ?Sized> ContentHash for &T {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        (**self).hash_content(hasher);
    }
}

impl<T: ContentHash> ContentHash for Option<T> {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        match self {
            None => hasher.variant("none", 0, &[]),
            Some(value) => hasher.variant("some", 1, &[("value", value)]),
        }
    }
}

impl<T: ContentHash> ContentHash for [T] {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        hasher.sequence(self.len(), self.iter().map(|value| value as &dyn ContentHash));
    }
}

impl<T: ContentHash> ContentHash for Vec<T> {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        self.as_slice().hash_content(hasher);
    }
}

impl<T: ContentHash, const N: usize> ContentHash for [T; N] {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        self.as_slice().hash_content(hasher);
    }
}

impl<K: ContentHash, V: ContentHash> ContentHash for BTreeMap<K, V> {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        let entries = self.iter();
        let values = entries.flat_map(|(key, value)| [key as &dyn ContentHash, value]);
        hasher.sequence(2 * self.len(), values);
    }
}

impl<A: ContentHash, B: ContentHash> ContentHash for (A, B) {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        hasher.sequence(2, [&self.0 as &dyn ContentHash, &self.1]);
    }
}

impl<A: ContentHash, B: ContentHash, C: ContentHash> ContentHash for (A, B, C) {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        hasher.sequence(3, [&self.0 as &dyn ContentHash, &self.1, &self.2]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn borders_between_values_count() {
        assert_ne!(digest_of(&vec!["ab", "c"]), digest_of(&vec!["a", "bc"]));
        assert_ne!(
            digest_of(&vec![vec![1_u8], vec![]]),
            digest_of(&vec![vec![], vec![1_u8]])
        );
        assert_ne!(digest_of(&vec![1_u8]), digest_of(&Bytes(&[1])));
        assert_ne!(digest_of(&None::<u8>), digest_of(&Some(0_u8)));
    }

    /// Keys of memos, fingerprints and seeds are made of these: no digest may change.
    #[test]
    fn the_digests_of_all_forms_of_values_stay_what_they_were() {
        let (a, b) = (Digest::from_content(b"a"), Digest::from_content(b"b"));
        let named = BTreeMap::from([("x".to_owned(), a), ("y".to_owned(), b)]);
        let digests = [
            ("unsigned", digest_of(&7_u8), "9dc616b7032b"),
            ("u32", digest_of(&u32::MAX), "b25d8d942383"),
            ("u64", digest_of(&u64::MAX), "b8767ee20a23"),
            ("usize", digest_of(&640_usize), "821f98055f5a"),
            ("truth", digest_of(&true), "e5a2256c896d"),
            ("text", digest_of(&"mars".to_owned()), "1c858f56e970"),
            ("digest", digest_of(&a), "eb6628949d36"),
            ("none", digest_of(&None::<Digest>), "6366b9f55dc1"),
            ("some", digest_of(&Some("2022-03-01")), "2e4886cf035d"),
            ("list", digest_of(&vec![a, b]), "a46b351f0ff8"),
            ("empty list", digest_of(&Vec::<Digest>::new()), "0b2f9f5b3fbb"),
            (
                "bytes as a list",
                digest_of(&Some(vec![1_u8, 2, 255])),
                "38ecb8f94e0e",
            ),
            ("array", digest_of(&[a, b]), "a46b351f0ff8"),
            ("map", digest_of(&named), "8e921bc66521"),
            ("pair", digest_of(&("witnesses", a)), "b5c34b818ce7"),
            (
                "pairs",
                digest_of(&vec![("x", Some("1")), ("y", None)]),
                "7183f16834d2",
            ),
            (
                "nested",
                digest_of(&(("features", 3_u32), (800_u32, 640_u32), a)),
                "b935d2daf86c",
            ),
            (
                "inputs",
                digest_of(&(
                    ("train", 19_u32, "{}".to_owned()),
                    (Some("cpu".to_owned()), named),
                    "",
                )),
                "14c7d07a16b3",
            ),
        ];
        for (form, digest, expected) in digests {
            assert_eq!(digest.short(), expected, "{form}");
        }
    }
}
