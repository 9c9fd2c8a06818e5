//! Content hashes: one walk over a value makes both its digest and its text.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use crate::Digest;

/// A value whose content can be visited in one fixed order.
///
/// One visitor hashes, another writes text: the text that `marf why` compares holds what the key holds. Derive
/// it; the names of structs, fields and variants are part of the content.
pub trait ContentHash {
    /// Passes the whole content of `self` to a visitor.
    fn walk(&self, visitor: &mut dyn Visitor);
}

/// Receives the content of a value, one call for each leaf.
///
/// Names and lengths come before what they describe, so different contents make different calls.
pub trait Visitor {
    /// A struct, or a struct-like variant's fields, with this many fields.
    fn open(&mut self, name: &str, fields: usize);
    /// The next value is this field.
    fn field(&mut self, name: &str);
    /// The end of a struct, sequence or map.
    fn close(&mut self);
    /// An enum's variant, by ordinal; its fields follow as a struct.
    fn variant(&mut self, name: &str, ordinal: u32);
    /// A sequence (or a sorted map's alternating keys and values) of this many values.
    fn sequence(&mut self, len: u64);
    /// An unsigned integer.
    fn unsigned(&mut self, value: u64);
    /// A signed integer.
    fn signed(&mut self, value: i64);
    /// A float; all NaN are one, both zeros are one.
    fn float(&mut self, value: f64);
    /// A truth value.
    fn truth(&mut self, value: bool);
    /// A text, UTF-8.
    fn text(&mut self, value: &str);
    /// A byte string.
    fn bytes(&mut self, value: &[u8]);
    /// A digest of something stored elsewhere.
    fn digest(&mut self, value: &Digest);
}

/// Returns the digest of a value's content.
pub fn digest_of(value: &(impl ContentHash + ?Sized)) -> Digest {
    let mut hasher = HashVisitor(blake3::Hasher::new());
    value.walk(&mut hasher);
    Digest::from_bytes(*hasher.0.finalize().as_bytes())
}

/// Returns a value's content as text, one leaf a line: `path.to.field = value`.
pub fn manifest_text(value: &(impl ContentHash + ?Sized)) -> String {
    let mut writer = TextVisitor::default();
    value.walk(&mut writer);
    writer.text
}

/// Hashes a tag byte for each call, then lengths as u64 LE, ordinals as u32 LE, floats by bits.
struct HashVisitor(blake3::Hasher);

impl HashVisitor {
    fn tagged(&mut self, tag: u8, payload: &[u8]) {
        self.0.update(&[tag]);
        self.0.update(payload);
    }

    fn sized(&mut self, tag: u8, payload: &[u8]) {
        self.tagged(tag, &(payload.len() as u64).to_le_bytes());
        self.0.update(payload);
    }
}

impl Visitor for HashVisitor {
    fn open(&mut self, name: &str, fields: usize) {
        self.sized(b'{', name.as_bytes());
        self.0.update(&(fields as u64).to_le_bytes());
    }
    fn field(&mut self, name: &str) {
        self.sized(b'.', name.as_bytes());
    }
    fn close(&mut self) {
        self.tagged(b'}', &[]);
    }
    fn variant(&mut self, name: &str, ordinal: u32) {
        self.sized(b'|', name.as_bytes());
        self.0.update(&ordinal.to_le_bytes());
    }
    fn sequence(&mut self, len: u64) {
        self.tagged(b'[', &len.to_le_bytes());
    }
    fn unsigned(&mut self, value: u64) {
        self.tagged(b'u', &value.to_le_bytes());
    }
    fn signed(&mut self, value: i64) {
        self.tagged(b'i', &value.to_le_bytes());
    }
    fn float(&mut self, value: f64) {
        self.tagged(b'f', &canonical(value).to_bits().to_le_bytes());
    }
    fn truth(&mut self, value: bool) {
        self.tagged(b'b', &[u8::from(value)]);
    }
    fn text(&mut self, value: &str) {
        self.sized(b's', value.as_bytes());
    }
    fn bytes(&mut self, value: &[u8]) {
        self.sized(b'y', value);
    }
    fn digest(&mut self, value: &Digest) {
        self.tagged(b'#', value.as_bytes());
    }
}

fn canonical(value: f64) -> f64 {
    match value {
        nan if nan.is_nan() => f64::NAN,
        0.0 => 0.0, // also -0.0
        other => other,
    }
}

/// Writes one line for each leaf.
#[derive(Default)]
struct TextVisitor {
    text: String,
    path: Vec<String>,
    counters: Vec<Option<usize>>,
}

impl TextVisitor {
    fn leaf(&mut self, value: &str) {
        self.next_element();
        let path = if self.path.is_empty() {
            "value".to_owned()
        } else {
            self.path.join(".")
        };
        let _ = writeln!(self.text, "{path} = {value}"); // writing to a String cannot fail
        self.done();
    }

    /// Appends the index of a value inside a sequence to the path.
    fn next_element(&mut self) {
        if let Some(Some(index)) = self.counters.last_mut() {
            self.path.push(index.to_string());
            *index += 1;
        }
    }

    fn done(&mut self) {
        self.path.pop();
    }
}

impl Visitor for TextVisitor {
    fn open(&mut self, _name: &str, _fields: usize) {
        self.next_element();
        self.counters.push(None);
    }
    fn field(&mut self, name: &str) {
        self.path.push(name.to_owned());
    }
    fn close(&mut self) {
        self.counters.pop();
        self.done();
    }
    fn variant(&mut self, name: &str, _ordinal: u32) {
        let keep = self.path.clone();
        let keep_counter = self.counters.last().copied();
        self.leaf(name);
        // The variant's fields follow under the same path.
        self.path = keep;
        if let (Some(last), Some(kept)) = (self.counters.last_mut(), keep_counter) {
            *last = kept;
        }
    }
    fn sequence(&mut self, len: u64) {
        self.next_element();
        if len == 0 {
            let path = self.path.join(".");
            let _ = writeln!(self.text, "{path} = []");
        }
        self.counters.push(Some(0));
    }
    fn unsigned(&mut self, value: u64) {
        self.leaf(&value.to_string());
    }
    fn signed(&mut self, value: i64) {
        self.leaf(&value.to_string());
    }
    fn float(&mut self, value: f64) {
        self.leaf(&format!("{:?}", canonical(value)));
    }
    fn truth(&mut self, value: bool) {
        self.leaf(if value { "true" } else { "false" });
    }
    fn text(&mut self, value: &str) {
        self.leaf(&format!("{value:?}"));
    }
    fn bytes(&mut self, value: &[u8]) {
        self.leaf(&format!("{} bytes {}", value.len(), Digest::of(value)));
    }
    fn digest(&mut self, value: &Digest) {
        self.leaf(&value.to_string());
    }
}

macro_rules! leaf {
    ($call:ident as $wide:ty: $($ty:ty),*) => {$(
        impl ContentHash for $ty {
            fn walk(&self, visitor: &mut dyn Visitor) {
                visitor.$call(<$wide>::from(*self));
            }
        }
    )*};
}
leaf!(unsigned as u64: u8, u16, u32, u64);
leaf!(signed as i64: i8, i16, i32, i64);
leaf!(float as f64: f32, f64);
leaf!(truth as bool: bool);

impl ContentHash for usize {
    fn walk(&self, visitor: &mut dyn Visitor) {
        visitor.unsigned(*self as u64);
    }
}

impl ContentHash for str {
    fn walk(&self, visitor: &mut dyn Visitor) {
        visitor.text(self);
    }
}

impl ContentHash for String {
    fn walk(&self, visitor: &mut dyn Visitor) {
        visitor.text(self);
    }
}

impl ContentHash for Digest {
    fn walk(&self, visitor: &mut dyn Visitor) {
        visitor.digest(self);
    }
}

impl<T: ContentHash + ?Sized> ContentHash for &T {
    fn walk(&self, visitor: &mut dyn Visitor) {
        (**self).walk(visitor);
    }
}

impl<T: ContentHash + ?Sized> ContentHash for Box<T> {
    fn walk(&self, visitor: &mut dyn Visitor) {
        (**self).walk(visitor);
    }
}

impl<T: ContentHash> ContentHash for Option<T> {
    fn walk(&self, visitor: &mut dyn Visitor) {
        match self {
            None => {
                visitor.variant("none", 0);
                visitor.open("none", 0);
            }
            Some(value) => {
                visitor.variant("some", 1);
                visitor.open("some", 1);
                visitor.field("value");
                value.walk(visitor);
            }
        }
        visitor.close();
    }
}

impl<T: ContentHash> ContentHash for [T] {
    fn walk(&self, visitor: &mut dyn Visitor) {
        visitor.sequence(self.len() as u64);
        self.iter().for_each(|value| value.walk(visitor));
        visitor.close();
    }
}

impl<T: ContentHash> ContentHash for Vec<T> {
    fn walk(&self, visitor: &mut dyn Visitor) {
        self.as_slice().walk(visitor);
    }
}

impl<T: ContentHash, const N: usize> ContentHash for [T; N] {
    fn walk(&self, visitor: &mut dyn Visitor) {
        self.as_slice().walk(visitor);
    }
}

impl<T: ContentHash> ContentHash for BTreeSet<T> {
    fn walk(&self, visitor: &mut dyn Visitor) {
        visitor.sequence(self.len() as u64);
        self.iter().for_each(|value| value.walk(visitor));
        visitor.close();
    }
}

impl<K: ContentHash, V: ContentHash> ContentHash for BTreeMap<K, V> {
    fn walk(&self, visitor: &mut dyn Visitor) {
        visitor.sequence(2 * self.len() as u64);
        for (key, value) in self {
            key.walk(visitor);
            value.walk(visitor);
        }
        visitor.close();
    }
}

macro_rules! tuple {
    ($($name:ident $index:tt),+) => {
        impl<$($name: ContentHash),+> ContentHash for ($($name,)+) {
            fn walk(&self, visitor: &mut dyn Visitor) {
                visitor.sequence(const { [$($index),+].len() as u64 });
                $(self.$index.walk(visitor);)+
                visitor.close();
            }
        }
    };
}
tuple!(A 0, B 1);
tuple!(A 0, B 1, C 2);

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(crate::ContentHash, Clone)]
    struct Outer {
        name: String,
        list: Vec<Inner>,
        rate: f32,
    }

    #[derive(crate::ContentHash, Clone)]
    enum Inner {
        Empty,
        Pair(u32, i64),
        Named { seed: u64 },
    }

    fn sample() -> Outer {
        Outer {
            name: "a".into(),
            list: vec![Inner::Empty, Inner::Pair(1, -2), Inner::Named { seed: u64::MAX }],
            rate: 0.5,
        }
    }

    #[test]
    fn the_text_names_every_leaf_once() {
        let text = manifest_text(&sample());
        assert_eq!(
            text,
            "name = \"a\"\nlist.0 = Empty\nlist.1 = Pair\nlist.1.0 = 1\nlist.1.1 = -2\nlist.2 = Named\n\
             list.2.seed = 18446744073709551615\nrate = 0.5\n"
        );
    }

    #[test]
    fn every_change_of_content_changes_the_key() {
        let base = digest_of(&sample());
        let mut others = [sample(), sample(), sample(), sample()];
        others[0].name = "b".into();
        others[1].list.pop();
        others[2].rate = 0.25;
        others[3].list[2] = Inner::Named { seed: u64::MAX - 1 };
        for (index, other) in others.iter().enumerate() {
            assert_ne!(digest_of(other), base, "change {index}");
        }
        assert_eq!(digest_of(&sample()), base);
    }

    #[test]
    fn a_renamed_struct_keeps_its_key_under_its_first_name() {
        #[derive(crate::ContentHash)]
        struct First {
            seed: u64,
        }
        #[derive(crate::ContentHash)]
        #[content_hash(name = "First")]
        struct Renamed {
            seed: u64,
        }
        assert_eq!(digest_of(&First { seed: 3 }), digest_of(&Renamed { seed: 3 }));
    }

    #[test]
    fn one_nan_and_one_zero() {
        assert_eq!(digest_of(&f32::NAN), digest_of(&-f32::NAN));
        assert_eq!(digest_of(&0.0_f64), digest_of(&-0.0_f64));
        assert_ne!(digest_of(&0.0_f64), digest_of(&f64::MIN_POSITIVE));
        assert_ne!(digest_of(&f64::INFINITY), digest_of(&f64::NEG_INFINITY));
    }

    #[test]
    fn borders_between_values_count() {
        assert_ne!(digest_of(&vec!["ab", "c"]), digest_of(&vec!["a", "bc"]));
        assert_ne!(
            digest_of(&vec![vec![1_u8], vec![]]),
            digest_of(&vec![vec![], vec![1_u8]])
        );
        assert_ne!(digest_of(&1_u64), digest_of(&1_i64));
        assert_ne!(digest_of(&None::<u8>), digest_of(&Some(0_u8)));
    }
}
