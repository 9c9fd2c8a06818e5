//! Which photos may show the view of another: by hash, by name and by shape.

use std::collections::{BTreeMap, BTreeSet};

use crate::descriptor::PixelSize;
use crate::index::{HashIndex, Search};
use crate::relation::RelationKeys;
use crate::similarity::aspect_class;

/// Most candidates of many photos that are held at once, 4 bytes each.
const MOST_CANDIDATES: usize = 4 << 20;

/// What a photo is found by.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PhotoKeys {
    /// Its size.
    pub(crate) size: PixelSize,
    /// Its hashes, that of the brightness first.
    pub(crate) hashes: Vec<u64>,
    /// What relates it to others.
    pub(crate) relation: RelationKeys,
}

/// Search keys of photos, each at the position of its insertion.
///
/// Of 1,000,000 photos with one hash each the tables take 57 bytes a photo, and 16 more where names are known.
pub(crate) struct Candidates {
    search: Search,
    hashes: HashIndex,
    /// Positions by the key of an exposure, and by that of a camera on a sol with a filter.
    related: SortedRuns,
    /// Filters that each camera used on each sol.
    filters: BTreeMap<u32, BTreeSet<u32>>,
    aspects: Vec<u8>,
}

impl Candidates {
    /// Returns no photos, to be searched like this.
    pub(crate) fn new(search: Search) -> Self {
        Self {
            search,
            hashes: HashIndex::new(search),
            related: SortedRuns::default(),
            filters: BTreeMap::new(),
            aspects: Vec::new(),
        }
    }

    /// Returns the number of photos.
    pub(crate) fn len(&self) -> u32 {
        self.aspects.len() as u32
    }

    /// Adds a photo at the next position.
    pub(crate) fn insert(&mut self, keys: &PhotoKeys) {
        let position = self.len();
        self.aspects.push(aspect_class(keys.size));
        if self.search == Search::Nearest {
            keys.hashes
                .iter()
                .take(1)
                .for_each(|hash| self.hashes.insert(*hash, position));
            return;
        }
        keys.hashes
            .iter()
            .for_each(|hash| self.hashes.insert(*hash, position));
        if let Some(exposure) = keys.relation.exposure {
            self.related.insert(exposure, position);
        }
        if let Some((camera, filter)) = keys.relation.camera {
            self.related.insert(with_filter(camera, filter), position);
            self.filters.entry(camera).or_default().insert(filter);
        }
    }

    /// Returns the positions of all photos that are near by a hash, or may be related, in ascending order. Photos of
    /// another shape are left out.
    pub(crate) fn find(&self, keys: &PhotoKeys) -> Vec<u32> {
        let mut found = Vec::new();
        keys.hashes
            .iter()
            .for_each(|hash| self.hashes.find_within(*hash, &mut found));
        self.with_related(keys, found)
    }

    /// Returns the results of [`Candidates::find`] for many photos. `None` if there are more than [`MOST_CANDIDATES`]
    /// for all of them together. These are better found one by one.
    pub(crate) fn find_many(&self, photos: &[&PhotoKeys]) -> Option<Vec<Vec<u32>>> {
        let hashes = (0..)
            .zip(photos)
            .flat_map(|(number, keys)| keys.hashes.iter().map(move |hash| (number, *hash)));
        let hashes: Vec<(u32, u64)> = hashes.collect();
        let (mut found, mut left) = (vec![Vec::new(); photos.len()], MOST_CANDIDATES);
        self.hashes.find_within_many(&hashes, |number, position| {
            left -= 1;
            if let Some(found) = found.get_mut(number as usize) {
                found.push(position);
            }
            left > 0
        });
        let all = photos
            .iter()
            .zip(found)
            .map(|(keys, found)| self.with_related(keys, found));
        (left > 0).then(|| all.collect())
    }

    /// Adds the photos that may be related, and sorts. Photos of another shape are left out.
    fn with_related(&self, keys: &PhotoKeys, mut found: Vec<u32>) -> Vec<u32> {
        if let Some(exposure) = keys.relation.exposure {
            self.related.find(exposure, &mut found);
        }
        if let Some((camera, filter)) = keys.relation.camera {
            let filters = self.filters.get(&camera).into_iter().flatten();
            for other in filters.filter(|other| **other != filter) {
                self.related.find(with_filter(camera, *other), &mut found);
            }
        }
        let class = aspect_class(keys.size);
        found.retain(|position| self.has_aspect(*position, class));
        found.sort_unstable();
        found.dedup();
        found
    }

    /// Calls `accept` with distance and position of photos by the hash of their brightness, the nearest first, ties
    /// by position, until it returns true or an error. Photos of another shape are left out.
    ///
    /// # Errors
    /// The error of `accept`.
    pub(crate) fn find_nearest<E>(
        &self,
        keys: &PhotoKeys,
        mut accept: impl FnMut(u32, u32) -> Result<bool, E>,
    ) -> Result<(), E> {
        let Some(hash) = keys.hashes.first() else {
            return Ok(());
        };
        let class = aspect_class(keys.size);
        self.hashes.find_nearest(*hash, |distance, position| {
            Ok(self.has_aspect(position, class) && accept(distance, position)?)
        })
    }

    /// Whether the photo at a position may have an aspect ratio of this class.
    fn has_aspect(&self, position: u32, class: u8) -> bool {
        let own = self.aspects.get(position as usize);
        own.is_some_and(|own| own.abs_diff(class) <= 1)
    }
}

/// Returns the key of a camera on a sol with a filter.
fn with_filter(camera: u32, filter: u32) -> u32 {
    camera ^ filter.rotate_left(7)
}

/// Positions by key, in sorted runs, each at most half as long as the one before it: 8 bytes a position.
#[derive(Default)]
struct SortedRuns(Vec<Vec<(u32, u32)>>);

impl SortedRuns {
    fn insert(&mut self, key: u32, position: u32) {
        let mut run = vec![(key, position)];
        while let Some(mut longer) = self.0.pop_if(|longer| longer.len() <= run.len()) {
            longer.append(&mut run);
            longer.sort();
            run = longer;
        }
        self.0.push(run);
    }

    fn find(&self, key: u32, found: &mut Vec<u32>) {
        for run in &self.0 {
            let from = run.partition_point(|(other, _)| *other < key);
            let equal = run[from..].iter().take_while(|(other, _)| *other == key);
            found.extend(equal.map(|(_, position)| *position));
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn keys(hash: u64, exposure: Option<u32>, camera: Option<(u32, u32)>) -> PhotoKeys {
        PhotoKeys {
            size: PixelSize {
                width: 40,
                height: 30,
            },
            hashes: vec![hash],
            relation: RelationKeys { exposure, camera },
        }
    }

    #[test]
    fn photos_are_found_by_hash_by_exposure_and_by_camera_with_another_filter() {
        let mut photos = Candidates::new(Search::Within(2));
        let mut upright = keys(0, Some(1), None);
        (upright.size.width, upright.size.height) = (30, 40);
        for keys in [
            keys(0, None, None),
            keys(!0, Some(1), Some((5, 1))),
            keys(0xff << 20, None, Some((5, 2))),
            keys(3, Some(2), Some((6, 2))),
            upright,
        ] {
            photos.insert(&keys);
        }
        assert_eq!(photos.find(&keys(1, None, None)), [0, 3]);
        assert_eq!(photos.find(&keys(0xff << 40, Some(1), None)), [1]);
        assert_eq!(photos.find(&keys(0xff << 40, None, Some((5, 1)))), [2]);
        assert_eq!(photos.find(&keys(0xff << 40, None, Some((5, 3)))), [1, 2]);
        assert!(photos.find(&keys(0xff << 40, Some(3), Some((6, 2)))).is_empty());
        let asked = [keys(1, Some(1), None), keys(0xff << 40, None, Some((5, 3)))];
        assert_eq!(
            photos.find_many(&asked.each_ref()).unwrap(),
            [vec![0, 1, 3], vec![1, 2]]
        );
    }

    proptest! {
        #[test]
        fn runs_give_back_every_position_of_a_key(keys in proptest::collection::vec(0_u32..9, 0..200)) {
            let mut runs = SortedRuns::default();
            for (position, key) in (0..).zip(&keys) {
                runs.insert(*key, position);
            }
            for key in 0..10 {
                let mut found = Vec::new();
                runs.find(key, &mut found);
                found.sort_unstable();
                let expected: Vec<u32> = (0..).zip(&keys).filter(|(_, other)| **other == key).map(|(at, _)| at).collect();
                prop_assert_eq!(found, expected);
            }
        }
    }
}
