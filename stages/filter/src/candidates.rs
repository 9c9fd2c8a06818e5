//! Which photos may show the view of another: by hash, by name and by shape.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

use serde::{Deserialize, Serialize};

use crate::descriptor::PixelSize;
use crate::relation::RelationKeys;
use crate::similarity::aspect_class;

/// What hashes are searched for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Search {
    /// All at most this many bits away.
    Within(u32),
    /// The nearest first.
    Nearest,
}

/// What a photo is found by.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct PhotoKeys {
    /// Its size.
    pub(crate) size: PixelSize,
    /// Its hashes, that of the brightness first.
    pub(crate) hashes: Vec<u64>,
    /// What relates it to others.
    pub(crate) relation: RelationKeys,
}

/// Search keys of photos, each at the position of its insertion. A hash is compared with all others, which takes 2 to 4 ns
/// each.
pub(crate) struct Candidates {
    search: Search,
    /// All hashes, each with the position of its photo.
    hashes: Vec<(u64, u32)>,
    /// Positions by the key of an exposure, and by that of a camera on a sol with a filter.
    related: BTreeMap<u32, Vec<u32>>,
    /// Filters that each camera used on each sol.
    filters: BTreeMap<u32, BTreeSet<u32>>,
    aspects: Vec<u8>,
}

impl Candidates {
    /// Returns no photos, to be searched like this.
    pub(crate) fn new(search: Search) -> Self {
        Self {
            search,
            hashes: Vec::new(),
            related: BTreeMap::new(),
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
            self.hashes
                .extend(keys.hashes.first().map(|hash| (*hash, position)));
            return;
        }
        self.hashes
            .extend(keys.hashes.iter().map(|hash| (*hash, position)));
        if let Some(exposure) = keys.relation.exposure {
            self.related.entry(exposure).or_default().push(position);
        }
        if let Some((camera, filter)) = keys.relation.camera {
            let key = with_filter(camera, filter);
            self.related.entry(key).or_default().push(position);
            self.filters.entry(camera).or_default().insert(filter);
        }
    }

    /// Returns the positions of all photos that are near by a hash, or may be related, in ascending order. Photos of
    /// another shape are left out.
    pub(crate) fn find(&self, keys: &PhotoKeys) -> Vec<u32> {
        let mut found = Vec::new();
        if let Search::Within(radius) = self.search {
            for hash in &keys.hashes {
                let near = self
                    .hashes
                    .iter()
                    .filter(|(other, _)| (hash ^ other).count_ones() <= radius);
                found.extend(near.map(|(_, position)| *position));
            }
        }
        if let Some(exposure) = keys.relation.exposure {
            found.extend(self.related.get(&exposure).into_iter().flatten());
        }
        if let Some((camera, filter)) = keys.relation.camera {
            let filters = self.filters.get(&camera).into_iter().flatten();
            for other in filters.filter(|other| **other != filter) {
                let key = with_filter(camera, *other);
                found.extend(self.related.get(&key).into_iter().flatten());
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
        let near = self
            .hashes
            .iter()
            .filter(|(_, position)| self.has_aspect(*position, class));
        let mut nearest: BinaryHeap<Reverse<(u32, u32)>> = near
            .map(|(other, position)| Reverse(((hash ^ other).count_ones(), *position)))
            .collect();
        while let Some(Reverse((distance, position))) = nearest.pop() {
            if accept(distance, position)? {
                break;
            }
        }
        Ok(())
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

#[cfg(test)]
mod tests {
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
        assert_eq!(photos.find(&keys(1, Some(1), None)), [0, 1, 3]);
    }

    #[test]
    fn the_nearest_comes_first_and_of_equals_the_first() {
        let mut photos = Candidates::new(Search::Nearest);
        for hash in [0b111, 0b1, 0b10, !0] {
            photos.insert(&keys(hash, None, None));
        }
        let mut seen = Vec::new();
        let ended: Result<(), std::convert::Infallible> =
            photos.find_nearest(&keys(0, None, None), |bits, position| {
                seen.push((bits, position));
                Ok(seen.len() == 3)
            });
        assert_eq!((ended, seen), (Ok(()), vec![(1, 1), (1, 2), (3, 0)]));
    }
}
