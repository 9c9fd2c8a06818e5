//! Which photo a name in a camera file means.

use std::borrow::Cow;
use std::collections::BTreeMap;

use icu_normalizer::ComposingNormalizerBorrowed;

use crate::photos::{InputPhoto, without_extension};

/// The photos of the input set by name.
pub(super) struct PhotoNames<'a> {
    items: &'a [InputPhoto],
    /// Path of each photo, composed as [`composed`] does.
    paths: Vec<String>,
    /// Indices by base name without extension.
    by_stem: BTreeMap<String, Vec<usize>>,
}

/// The photos that a name may mean.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Match {
    /// None.
    Absent,
    /// Exactly this one.
    One(usize),
    /// One of these, all equally likely.
    Several(Vec<usize>),
}

impl<'a> PhotoNames<'a> {
    /// Indexes the photos.
    pub fn new(items: &'a [InputPhoto]) -> Self {
        let paths: Vec<String> = items
            .iter()
            .map(|item| composed(&item.facts.file).into_owned())
            .collect();
        let mut by_stem: BTreeMap<String, Vec<usize>> = BTreeMap::new();
        for (index, path) in paths.iter().enumerate() {
            by_stem.entry(stem(path).to_owned()).or_default().push(index);
        }
        Self {
            items,
            paths,
            by_stem,
        }
    }

    /// Returns the photo of this name, by the first rule that finds one:
    ///
    /// - the same path,
    /// - a path that ends as the name does (or the other way round), with and then without the extensions,
    /// - the same id,
    /// - for a name that starts with `/`, the path that shares most of its tail.
    ///
    /// Letters with accents match composed and decomposed. A name that matches nothing is tried again with `%20` and the like decoded.
    pub fn find(&self, file: &str) -> Match {
        let file = composed(file);
        match (self.find_spelled(&file), percent_decoded(&file)) {
            (Match::Absent, Some(decoded)) => self.find_spelled(&composed(&decoded)),
            (found, _) => found,
        }
    }

    fn find_spelled(&self, name: &str) -> Match {
        let file = name.trim_start_matches('/');
        // A name without an extension may contain dots: both readings of its stem count.
        let mut candidates: Vec<usize> = [stem(file), base(file)]
            .into_iter()
            .filter_map(|stem| self.by_stem.get(stem))
            .flatten()
            .copied()
            .collect();
        candidates.sort_unstable();
        candidates.dedup();
        let path = |index: usize| self.paths[index].as_str();
        let same = |index: usize| path(index) == file;
        let ends = |index: usize| ends_with(path(index), file);
        let ends_without = |index: usize| {
            let bare = without_extension(path(index));
            ends_with(bare, without_extension(file)) || ends_with(bare, file)
        };
        let longest = candidates
            .iter()
            .map(|index| shared_tail(path(*index), file))
            .max();
        let shares_most =
            |index: usize| name.starts_with('/') && Some(shared_tail(path(index), file)) == longest;
        let tests: [&dyn Fn(usize) -> bool; 4] = [&same, &ends, &ends_without, &shares_most];
        let found: Vec<Vec<usize>> = tests
            .iter()
            .map(|test| candidates.iter().copied().filter(|index| test(*index)).collect())
            .collect();
        let only = found.iter().find(|found| found.len() == 1).map(|found| found[0]);
        if let Some(only) = only.or_else(|| self.by_id(file)) {
            return Match::One(only);
        }
        let several = found.into_iter().find(|found| !found.is_empty());
        several.map_or(Match::Absent, Match::Several)
    }

    /// Returns the photo with this id.
    fn by_id(&self, file: &str) -> Option<usize> {
        let named = |item: &InputPhoto| item.id == file || item.id == base(file) || item.id == stem(file);
        self.items.iter().position(named)
    }
}

/// Returns a name with every letter and its accents as one character, as most systems write names (Unicode NFC).
pub(super) fn composed(name: &str) -> Cow<'_, str> {
    ComposingNormalizerBorrowed::new_nfc().normalize(name)
}

/// Returns a name with `%20` and the like decoded, or `None` if it has none.
fn percent_decoded(name: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(name.len());
    let mut rest = name.as_bytes();
    while let Some((first, tail)) = rest.split_first() {
        let code = tail.first_chunk::<2>().filter(|_| *first == b'%');
        let code = code.and_then(|code| u8::from_str_radix(std::str::from_utf8(code).ok()?, 16).ok());
        bytes.push(code.unwrap_or(*first));
        rest = if code.is_some() { &tail[2..] } else { tail };
    }
    let decoded = String::from_utf8(bytes).ok()?;
    (decoded != name).then_some(decoded)
}

fn base(file: &str) -> &str {
    file.rsplit('/').next().unwrap_or(file)
}

fn stem(file: &str) -> &str {
    without_extension(base(file))
}

/// Returns whether one path ends with the other, in whole components: `f.png` and `images/f.png`.
fn ends_with(a: &str, b: &str) -> bool {
    let (long, short) = if a.len() >= b.len() { (a, b) } else { (b, a) };
    let start = long.strip_suffix(short);
    start.is_some_and(|start| start.is_empty() || start.ends_with('/'))
}

/// Returns how many components two paths share from the end, extensions aside.
fn shared_tail(a: &str, b: &str) -> usize {
    let parts = |path| without_extension(path).rsplit('/');
    parts(a).zip(parts(b)).take_while(|(a, b)| a == b).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_cache::Digest;
    use marf_scene::PhotoFacts;

    fn items(files: &[&str]) -> Vec<InputPhoto> {
        let item = |file: &&str| {
            let facts = PhotoFacts {
                file: (*file).to_owned(),
                ..PhotoFacts::default()
            };
            InputPhoto::new(
                base(file).to_uppercase(),
                Digest::from_content(file.as_bytes()),
                facts,
            )
        };
        files.iter().map(item).collect()
    }

    #[test]
    fn a_name_finds_its_photo_and_no_other() {
        let items = items(&[
            "images/a.jpg",
            "left/b.png",
            "right/b.png",
            "test/r_0.png",
            "v1.5.png",
        ]);
        let photos = PhotoNames::new(&items);
        let cases = [
            ("images/a.jpg", Match::One(0)),
            ("a.jpg", Match::One(0)),
            ("data/images/a.jpg", Match::One(0)),
            ("images/a", Match::One(0)),
            ("images/a.png", Match::One(0)),
            ("a.jpeg", Match::One(0)),
            ("photos/a.jpg", Match::Absent),
            ("left/b.png", Match::One(1)),
            ("right/b", Match::One(2)),
            ("b.png", Match::Several(vec![1, 2])),
            ("train/r_0", Match::Absent),
            ("test/r_0", Match::One(3)),
            ("v1.5", Match::One(4)),
            ("A.JPG", Match::One(0)),
            ("", Match::Absent),
            ("mages/a.jpg", Match::Absent),
        ];
        for (name, expected) in cases {
            assert_eq!(photos.find(name), expected, "{name}");
        }
    }

    #[test]
    fn a_path_from_elsewhere_means_the_photo_that_shares_most_of_its_tail() {
        let items = items(&["scan/left/a.jpg", "scan/right/a.jpg", "b.jpg"]);
        let photos = PhotoNames::new(&items);
        for (name, expected) in [
            ("/home/anna/right/a.jpg", Match::One(1)),
            ("/home/anna/a.jpg", Match::Several(vec![0, 1])),
            ("/D:/photos/b.png", Match::One(2)),
            ("/home/c.jpg", Match::Absent),
        ] {
            assert_eq!(photos.find(name), expected, "{name}");
        }
    }

    #[test]
    fn a_letter_matches_composed_and_decomposed_and_percent_codes_are_read_where_nothing_else_fits() {
        let items = items(&["Gr\u{f6}\u{df}e 1.jpg", "ba\u{308}r.jpg", "100%25.jpg"]);
        let photos = PhotoNames::new(&items);
        for (name, expected) in [
            ("Gro\u{308}\u{df}e 1.jpg", Match::One(0)),
            ("Gr%C3%B6%C3%9Fe%201.jpg", Match::One(0)),
            ("b\u{e4}r.jpg", Match::One(1)),
            ("100%25.jpg", Match::One(2)),
            ("100%.jpg", Match::Absent),
            ("%zz.jpg", Match::Absent),
        ] {
            assert_eq!(photos.find(name), expected, "{name}");
        }
    }
}
