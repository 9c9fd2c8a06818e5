//! Which photo a name in a camera file means.

use std::collections::BTreeMap;

use crate::photos::{InputPhoto, without_extension};

/// The photos of the input set by name.
pub(super) struct PhotoNames<'a> {
    items: &'a [InputPhoto],
    /// Indices by base name without extension.
    by_stem: BTreeMap<&'a str, Vec<usize>>,
}

impl<'a> PhotoNames<'a> {
    /// Indexes the photos.
    pub fn new(items: &'a [InputPhoto]) -> Self {
        let mut by_stem: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        for (index, item) in items.iter().enumerate() {
            by_stem.entry(stem(&item.facts.file)).or_default().push(index);
        }
        Self { items, by_stem }
    }

    /// Returns the photo of this name: the same path; else the only one whose path ends as the name does (or the
    /// other way round), with and then without the extensions; else the one with this id.
    pub fn find(&self, file: &str) -> Option<usize> {
        // A name without an extension may contain dots: both readings of its stem count.
        let candidates: Vec<usize> = [stem(file), base(file)]
            .into_iter()
            .filter_map(|stem| self.by_stem.get(stem))
            .flatten()
            .copied()
            .collect();
        let path = |index: usize| self.items[index].facts.file.as_str();
        let same = |index: &usize| path(*index) == file;
        let ends = |index: &usize| ends_with(path(*index), file);
        let ends_without = |index: &usize| {
            let bare = without_extension(path(*index));
            ends_with(bare, without_extension(file)) || ends_with(bare, file)
        };
        only(candidates.iter().filter(|index| same(index)))
            .or_else(|| only(candidates.iter().filter(|index| ends(index))))
            .or_else(|| only(candidates.iter().filter(|index| ends_without(index))))
            .or_else(|| self.by_id(file))
    }

    /// Returns the photo with this id.
    fn by_id(&self, file: &str) -> Option<usize> {
        let named = |item: &InputPhoto| item.id == file || item.id == base(file) || item.id == stem(file);
        self.items.iter().position(named)
    }
}

fn base(file: &str) -> &str {
    file.rsplit('/').next().unwrap_or(file)
}

fn stem(file: &str) -> &str {
    without_extension(base(file))
}

/// Tells whether one path ends with the other, in whole components: `f.png` and `images/f.png`.
fn ends_with(a: &str, b: &str) -> bool {
    let (long, short) = if a.len() >= b.len() { (a, b) } else { (b, a) };
    let start = long.strip_suffix(short);
    start.is_some_and(|start| start.is_empty() || start.ends_with('/'))
}

/// Returns the only index; `None` if there are different ones.
fn only<'a>(mut found: impl Iterator<Item = &'a usize>) -> Option<usize> {
    let first = found.next()?;
    found.all(|other| other == first).then_some(*first)
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_cache::Digest;
    use marf_scene::PhotoFacts;

    fn items(files: &[&str]) -> Vec<InputPhoto> {
        let item = |file: &&str| InputPhoto {
            id: base(file).to_uppercase(),
            image: Digest::from_content(file.as_bytes()),
            labelled: false,
            facts: PhotoFacts {
                file: (*file).to_owned(),
                ..PhotoFacts::default()
            },
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
            ("images/a.jpg", Some(0)),
            ("a.jpg", Some(0)),
            ("data/images/a.jpg", Some(0)),
            ("images/a", Some(0)),
            ("images/a.png", Some(0)),
            ("a.jpeg", Some(0)),
            ("photos/a.jpg", None),
            ("left/b.png", Some(1)),
            ("right/b", Some(2)),
            ("b.png", None),
            ("train/r_0", None),
            ("test/r_0", Some(3)),
            ("v1.5", Some(4)),
            ("A.JPG", Some(0)),
            ("", None),
            ("mages/a.jpg", None),
        ];
        for (name, expected) in cases {
            assert_eq!(photos.find(name), expected, "{name}");
        }
    }
}
