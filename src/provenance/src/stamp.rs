//! Marks in exported copies: the digests of the stored object and of the run root, where the format has a place for them.
//!
//! | format | place |
//! |---|---|
//! | PNG | a `tEXt` chunk before `IEND` |
//! | HTML | a `meta` after the opening of `head` |
//! | PLY | a comment after the line `format` |
//! | JSON | the first key of an object, `marf` |
//!
//! All other formats have none (an MP4 is found by its own digest). The bytes without the mark are those of the object, which itself never holds one.

use marf_cache::Digest;

/// Mark in an exported copy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamp {
    /// The object of the store that it is a copy of.
    pub object: Digest,
    /// The root of the run that it was exported from.
    pub run: Digest,
}

/// Place and wrapping of a mark. Its length follows from the format alone.
struct Form {
    at: usize,
    before: Vec<u8>,
    after: Vec<u8>,
}

const PNG_START: &[u8] = b"\x89PNG\r\n\x1a\n";
/// Length, type and checksum of the empty chunk that ends a PNG.
const PNG_END: &[u8] = b"\0\0\0\0IEND\xaeB`\x82";
const PNG_KEYWORD: &[u8] = b"tEXtmarf\0";
const HTML_HEAD: &[u8] = b"<head>";
/// Bytes at the start of a page among which its head opens.
const HTML_START: usize = 256;
const DIGITS: usize = 64;
/// Digits of the checksum over the others.
const CHECK: usize = 16;
/// `object=` and `run=` with 64 digits each, `check=` with 16, and spaces.
const TEXT: usize = 7 + DIGITS + 1 + 4 + DIGITS + 1 + 6 + CHECK;

impl Stamp {
    /// Returns the copy of an object with the mark. `None` if its format has no place for one.
    pub fn add_to(&self, object: &[u8]) -> Option<Vec<u8>> {
        let form = form_of(object)?;
        let (start, rest) = object.split_at_checked(form.at)?;
        let mut copy = start.to_vec();
        copy.extend_from_slice(&form.before);
        copy.extend_from_slice(self.text().as_bytes());
        copy.extend_from_slice(&form.after);
        if form.before.ends_with(PNG_KEYWORD) {
            // The checksum of a chunk is over its type and its content.
            let checksum = crc32fast::hash(copy.get(start.len() + 4..)?);
            copy.extend_from_slice(&checksum.to_be_bytes());
        }
        copy.extend_from_slice(rest);
        Some(copy)
    }

    /// Splits a copy into the bytes of the object and the mark. `None` without a whole mark.
    ///
    /// The caller must check that these bytes have the digest in the mark.
    pub fn take_from(copy: &[u8]) -> Option<(Vec<u8>, Self)> {
        let (object, text) = cut(copy)?;
        let stamp = Self::parse(text)?;
        (stamp.add_to(&object).as_deref() == Some(copy)).then_some((object, stamp))
    }

    /// Returns the bytes of the object from a copy with an altered mark. `None` without the frame of a mark.
    pub fn take_altered_from(copy: &[u8]) -> Option<Vec<u8>> {
        cut(copy).map(|(object, _)| object)
    }

    /// Returns the words of a mark.
    fn text(&self) -> String {
        let said = format!("object={} run={}", self.object, self.run);
        let check = &Digest::from_content(said.as_bytes()).to_string()[..CHECK];
        format!("{said} check={check}")
    }

    fn parse(text: &[u8]) -> Option<Self> {
        let text = std::str::from_utf8(text).ok()?;
        let object = text.strip_prefix("object=")?.get(..DIGITS)?;
        let run = text.get(7 + DIGITS..)?.strip_prefix(" run=")?.get(..DIGITS)?;
        Some(Self {
            object: object.parse().ok()?,
            run: run.parse().ok()?,
        })
    }
}

/// Cuts a copy into the bytes of the object and the words of the mark, whatever these are.
fn cut(copy: &[u8]) -> Option<(Vec<u8>, &[u8])> {
    let at = place_in(copy)?;
    let (start, rest) = copy.split_at_checked(at)?;
    // The form of an object depends on bytes before the mark and on the last ones alone.
    let form = form_at(copy, at)?;
    let words = rest.strip_prefix(form.before.as_slice())?;
    let (text, rest) = words.split_at_checked(TEXT)?;
    let checksum = if form.before.ends_with(PNG_KEYWORD) { 4 } else { 0 };
    let object = [start, rest.get(form.after.len() + checksum..)?].concat();
    Some((object, text))
}

/// Returns where and how the mark of an object stands.
fn form_of(object: &[u8]) -> Option<Form> {
    let at = match () {
        () if object.starts_with(PNG_START) => object.len().checked_sub(PNG_END.len())?,
        () if object.starts_with(b"ply\n") => 4 + position(object.get(4..)?, b"\n")? + 1,
        () if object.starts_with(b"{") => 1,
        () => position(object.get(..object.len().min(HTML_START))?, HTML_HEAD)? + HTML_HEAD.len(),
    };
    form_at(object, at)
}

/// Returns where the mark of a copy begins, if it is the copy of an object of this format.
fn place_in(copy: &[u8]) -> Option<usize> {
    let end = |tail: usize| copy.len().checked_sub(tail);
    match () {
        () if copy.starts_with(PNG_START) => end(PNG_END.len() + 4 + PNG_KEYWORD.len() + TEXT + 4),
        () => form_of(copy).map(|form| form.at),
    }
}

/// Returns the wrapping of a mark at a place of an object or a copy. `None` if the format has none.
fn form_at(bytes: &[u8], at: usize) -> Option<Form> {
    let form = |before: &[u8], after: &[u8]| Form {
        at,
        before: before.to_vec(),
        after: after.to_vec(),
    };
    if bytes.starts_with(PNG_START) {
        let length = ((PNG_KEYWORD.len() - 4 + TEXT) as u32).to_be_bytes();
        return bytes
            .ends_with(PNG_END)
            .then(|| form(&[&length, PNG_KEYWORD].concat(), b""));
    }
    if bytes.starts_with(b"ply\n") {
        return bytes
            .get(4..)?
            .starts_with(b"format ")
            .then(|| form(b"comment marf ", b"\n"));
    }
    if bytes.starts_with(b"{") {
        // An empty object would end with a comma.
        let first = bytes.get(1..)?.iter().find(|byte| !byte.is_ascii_whitespace())?;
        return (*first == b'"').then(|| form(b"\"marf\":\"", b"\","));
    }
    bytes
        .starts_with(b"<!DOCTYPE html>")
        .then(|| form(b"<meta name=\"marf\" content=\"", b"\">"))
}

fn position(bytes: &[u8], part: &[u8]) -> Option<usize> {
    bytes.windows(part.len()).position(|window| window == part)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn stamp() -> Stamp {
        Stamp {
            object: Digest::from_content(b"object"),
            run: Digest::from_content(b"run"),
        }
    }

    fn png() -> Vec<u8> {
        let mut bytes = std::io::Cursor::new(Vec::new());
        let picture = image::RgbImage::from_fn(5, 3, |x, y| image::Rgb([x as u8 * 40, y as u8 * 80, 7]));
        picture.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
        bytes.into_inner()
    }

    fn objects() -> Vec<(&'static str, Vec<u8>)> {
        let ply = "ply\nformat binary_little_endian 1.0\nelement vertex 0\nend_header\n";
        vec![
            ("png", png()),
            ("ply", ply.as_bytes().to_vec()),
            ("json", b"{\n  \"a\": [1, 2]\n}".to_vec()),
            (
                "html",
                b"<!DOCTYPE html><html lang=\"en\"><head><meta charset=\"utf-8\"></head></html>".to_vec(),
            ),
        ]
    }

    #[test]
    fn a_mark_comes_off_again_and_leaves_the_object() {
        for (name, object) in objects() {
            let copy = stamp().add_to(&object).unwrap_or_else(|| panic!("{name}"));
            assert!(copy.len() > object.len() + 2 * 64, "{name}");
            assert_eq!(Stamp::take_from(&copy), Some((object.clone(), stamp())), "{name}");
            assert_eq!(
                Stamp::take_from(&object),
                None,
                "{name}: the object itself has none"
            );
        }
    }

    /// Other programs read the copy as they read the object.
    #[test]
    fn a_copy_is_a_whole_file_of_its_format() {
        let copy = stamp().add_to(&png()).unwrap();
        let (one, two) = (image::load_from_memory(&png()), image::load_from_memory(&copy));
        assert_eq!(one.unwrap(), two.unwrap());
        let copy = stamp().add_to(b"{\n  \"a\": [1, 2]\n}").unwrap();
        let json: serde_json::Value = serde_json::from_slice(&copy).unwrap();
        assert_eq!(json["a"][1], 2);
        assert!(json["marf"].as_str().unwrap().starts_with("object="));
    }

    #[test]
    fn an_altered_mark_is_none_and_still_comes_off() {
        for (name, object) in objects() {
            let copy = stamp().add_to(&object).unwrap();
            let at = position(&copy, b"run=").unwrap() + 10;
            let mut altered = copy.clone();
            altered[at] ^= 1;
            assert_eq!(Stamp::take_from(&altered), None, "{name}");
            assert_eq!(Stamp::take_altered_from(&altered), Some(object), "{name}");
        }
        assert_eq!(Stamp::take_altered_from(b"{\"a\":1}"), None);
    }

    #[test]
    fn formats_without_a_place_have_no_mark() {
        let others: [&[u8]; 9] = [
            b"",
            b"{",
            b"{}",
            b"{ }",
            b"[1]",
            b"a,b\n1,2\n",
            b"ply\nelement",
            b"\x89PNG\r\n\x1a\n",
            b"\0\0\0\x18ftypisom",
        ];
        for bytes in others {
            assert_eq!(stamp().add_to(bytes), None, "{bytes:?}");
            assert_eq!(Stamp::take_from(bytes), None, "{bytes:?}");
        }
    }

    proptest! {
        /// Whatever the object holds, also marks of its own.
        #[test]
        fn every_object_with_a_place_is_got_back(body in ".{0,300}", twice: bool) {
            let mut object = format!("{{\"a\":{}}}", serde_json::Value::from(body)).into_bytes();
            if twice {
                object = stamp().add_to(&object).unwrap();
            }
            let copy = stamp().add_to(&object).unwrap();
            prop_assert_eq!(Stamp::take_from(&copy), Some((object, stamp())));
        }

        #[test]
        fn no_bytes_make_it_stumble(bytes: Vec<u8>, start in 0_usize..5) {
            let starts: [&[u8]; 5] = [b"", PNG_START, b"ply\nformat ", b"{\"", b"<!DOCTYPE html><head>"];
            let bytes = [starts[start], bytes.as_slice()].concat();
            let _ = Stamp::take_from(&bytes);
            if let Some(copy) = stamp().add_to(&bytes) {
                prop_assert_eq!(Stamp::take_from(&copy), Some((bytes, stamp())));
            }
        }

        /// A copy with one flipped bit still says what it was, or is not a copy any more.
        #[test]
        fn a_flipped_bit_is_never_the_object(at: prop::sample::Index, bit in 0_u32..8, which in 0_usize..4) {
            let (_, object) = objects().swap_remove(which);
            let of = Stamp { object: Digest::from_content(&object), run: Digest::from_content(b"run") };
            let mut copy = of.add_to(&object).unwrap();
            let at = at.index(copy.len());
            copy[at] ^= 1 << bit;
            if let Some((bytes, stamp)) = Stamp::take_from(&copy) {
                prop_assert!(Digest::from_content(&bytes) != stamp.object);
            }
        }
    }
}
