//! The photos that `duplicate` has kept of earlier sols, as each sol added them.
//!
//! The data a sol adds is kept in two parts. [`Added`] holds the search keys of its photos, and every later run reads
//! it whole. It names blobs with the data to compare photos by, which are read when one of their photos is a
//! candidate.

use std::collections::BTreeMap;
use std::sync::Arc;

use marf_cache::Digest;
use marf_stage::{Ctx, StageError};

use crate::bytes::{put_number, put_part, put_text, take, take_number, take_part, take_text};
use crate::candidates::PhotoKeys;
use crate::descriptor::{PixelSize, put_hashes, take_hashes};
use crate::relation::{RelationKeys, Relative};
use crate::section::damaged;
use crate::similarity::Planes;

/// What a kept photo is compared by.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct KeptPhoto<'a> {
    pub(crate) id: &'a str,
    pub(crate) instrument: Option<&'a str>,
    pub(crate) filter: Option<&'a str>,
    pub(crate) sol: Option<u32>,
    pub(crate) size: PixelSize,
    /// Perceptual hashes, that of the brightness first.
    pub(crate) hashes: Vec<u64>,
    /// Digest of the gradient planes.
    pub(crate) planes: Digest,
}

impl<'a> KeptPhoto<'a> {
    /// Returns the facts that relate it to photos of later sols.
    pub(crate) fn relative(&self) -> Relative<'a> {
        Relative {
            id: self.id,
            instrument: self.instrument,
            filter: self.filter,
            sol: self.sol,
            row: None,
        }
    }

    fn put(&self, bytes: &mut Vec<u8>) {
        put_part(bytes, self.id.as_bytes());
        put_text(bytes, self.instrument);
        put_text(bytes, self.filter);
        put_number(bytes, self.sol.map_or(0, |sol| u64::from(sol) + 1));
        self.size.put(bytes);
        put_hashes(bytes, &self.hashes);
        bytes.extend(self.planes.as_bytes());
    }

    fn take(bytes: &mut &'a [u8]) -> Option<Self> {
        Some(Self {
            id: std::str::from_utf8(take_part(bytes)?).ok()?,
            instrument: take_text(bytes)?,
            filter: take_text(bytes)?,
            sol: match take_number(bytes)? {
                0 => None,
                sol => Some(u32::try_from(sol - 1).ok()?),
            },
            size: PixelSize::take(bytes)?,
            hashes: take_hashes(bytes)?,
            planes: Digest::from_bytes(take(bytes)?),
        })
    }
}

/// Photos of one blob: some 8 KB are read for a candidate.
const GROUP: usize = 64;

/// What a group of photos that a sol added are found by: 45 bytes a photo of one hash, 57 with a name of Mars 2020.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Added {
    /// Names the blob with what each photo is compared by.
    pub(crate) photos: Digest,
    /// Of each photo, in the same order, its keys and the digest of its planes.
    pub(crate) keys: Vec<(PhotoKeys, Digest)>,
}

impl Added {
    /// Stores the data to compare photos by, and returns the bytes of [`Added`]. Empty for no photos.
    ///
    /// # Errors
    /// A store that cannot be written.
    pub(crate) fn write(ctx: &Ctx<'_>, photos: &[(KeptPhoto<'_>, PhotoKeys)]) -> Result<Vec<u8>, StageError> {
        let mut bytes = Vec::new();
        for group in photos.chunks(GROUP) {
            let mut compared = Vec::new();
            for (photo, _) in group {
                let mut bytes = Vec::new();
                photo.put(&mut bytes);
                put_part(&mut compared, &bytes);
            }
            bytes.extend(ctx.put(&compared)?.as_bytes());
            bytes.push(group.len() as u8);
            for (photo, keys) in group {
                put_keys(&mut bytes, keys);
                bytes.extend(photo.planes.as_bytes());
            }
        }
        Ok(bytes)
    }

    /// Reads what [`Added::write`] returned, group by group.
    ///
    /// # Errors
    /// Bytes that are not that.
    pub(crate) fn read(mut bytes: &[u8]) -> Result<Vec<Self>, StageError> {
        let mut groups = Vec::new();
        while !bytes.is_empty() {
            groups.push(Self::take(&mut bytes).ok_or_else(|| unreadable(GROUP * groups.len()))?);
        }
        Ok(groups)
    }

    fn take(bytes: &mut &[u8]) -> Option<Self> {
        let photos = Digest::from_bytes(take(bytes)?);
        let [count] = take(bytes)?;
        let keys = (0..count).map(|_| take_keys(bytes).zip(take(bytes).map(Digest::from_bytes)));
        Some(Self {
            photos,
            keys: keys.collect::<Option<_>>()?,
        })
    }
}

fn unreadable(after: usize) -> StageError {
    damaged(format!(
        "photos kept of a sol cannot be read after the first {after}"
    ))
}

fn put_keys(bytes: &mut Vec<u8>, keys: &PhotoKeys) {
    let RelationKeys { exposure, camera } = keys.relation;
    bytes.push(u8::from(exposure.is_some()) | u8::from(camera.is_some()) << 1);
    let numbers = [exposure, camera.map(|pair| pair.0), camera.map(|pair| pair.1)];
    numbers
        .into_iter()
        .flatten()
        .for_each(|key| bytes.extend(key.to_le_bytes()));
    put_number(bytes, u64::from(keys.size.width));
    put_number(bytes, u64::from(keys.size.height));
    put_hashes(bytes, &keys.hashes);
}

fn take_keys(bytes: &mut &[u8]) -> Option<PhotoKeys> {
    let [flags] = take(bytes)?;
    if flags > 3 {
        return None;
    }
    let mut key = |flag: u8| match flags & flag {
        0 => Some(None),
        _ => Some(Some(u32::from_le_bytes(take(bytes)?))),
    };
    let (exposure, camera, filter) = (key(1)?, key(2)?, key(2)?);
    let mut side = || u32::try_from(take_number(bytes)?).ok();
    Some(PhotoKeys {
        relation: RelationKeys {
            exposure,
            camera: camera.zip(filter),
        },
        size: PixelSize {
            width: side()?,
            height: side()?,
        },
        hashes: take_hashes(bytes)?,
    })
}

/// The photos of one group as they are compared.
pub(crate) struct GroupPhotos {
    bytes: Arc<[u8]>,
    /// Where each photo begins.
    starts: Vec<u32>,
}

impl GroupPhotos {
    fn read(bytes: Arc<[u8]>) -> Option<Self> {
        let mut starts = Vec::new();
        let mut rest = &*bytes;
        while !rest.is_empty() {
            take_part(&mut rest).map(|part| starts.push((bytes.len() - rest.len() - part.len()) as u32))?;
        }
        Some(Self { bytes, starts })
    }

    /// Returns the photo at a place in the group.
    pub(crate) fn photo(&self, at: usize) -> Result<KeptPhoto<'_>, StageError> {
        let start = self.starts.get(at).map(|start| *start as usize);
        let photo = start.and_then(|start| KeptPhoto::take(&mut &self.bytes[start..]));
        photo.ok_or_else(|| unreadable(at))
    }
}

/// Most bytes of photos of earlier sols that are held: 60,000 photos.
const GROUPS_BYTES: usize = 8 << 20;
/// Most bytes of planes that are held: those of 500 photos of three bands.
const PLANES_BYTES: usize = 16 << 20;

/// Reads the data to compare photos by, and caches the most recently used.
pub(crate) struct Reader {
    groups: Recent<Digest, GroupPhotos>,
    planes: Recent<Digest, Planes>,
}

impl Reader {
    pub(crate) fn new() -> Self {
        Self {
            groups: Recent::new(GROUPS_BYTES),
            planes: Recent::new(PLANES_BYTES),
        }
    }

    /// Reads the photos of one group.
    ///
    /// # Errors
    /// A blob that is lost or damaged.
    pub(crate) fn group(&mut self, ctx: &Ctx<'_>, digest: &Digest) -> Result<Arc<GroupPhotos>, StageError> {
        self.groups.get(*digest, || {
            let bytes = ctx.get(digest)?;
            let size = bytes.len();
            let group = GroupPhotos::read(bytes).ok_or_else(|| unreadable(0))?;
            let size = size + 4 * group.starts.len();
            Ok((group, size))
        })
    }

    /// Reads the gradient planes of a photo.
    ///
    /// # Errors
    /// A blob that is lost or damaged.
    pub(crate) fn planes(&mut self, ctx: &Ctx<'_>, digest: &Digest) -> Result<Arc<Planes>, StageError> {
        self.planes.get(*digest, || {
            let bytes = ctx.get(digest)?;
            let planes = Planes::read(&bytes);
            let planes = planes
                .ok_or_else(|| damaged(format!("gradient planes {} cannot be read", digest.short())))?;
            let size = planes.size_bytes();
            Ok((planes, size))
        })
    }
}

/// A cache of the most recently used values by key.
struct Recent<K, V> {
    values: BTreeMap<K, (u64, Arc<V>, usize)>,
    by_use: BTreeMap<u64, K>,
    uses: u64,
    bytes: usize,
    most_bytes: usize,
}

impl<K: Ord + Copy, V> Recent<K, V> {
    fn new(most_bytes: usize) -> Self {
        Self {
            values: BTreeMap::new(),
            by_use: BTreeMap::new(),
            uses: 0,
            bytes: 0,
            most_bytes,
        }
    }

    /// Returns the value of a key, made with its size in bytes where it is not held.
    fn get(
        &mut self,
        key: K,
        make: impl FnOnce() -> Result<(V, usize), StageError>,
    ) -> Result<Arc<V>, StageError> {
        self.uses += 1;
        if let Some((used, value, _)) = self.values.get_mut(&key) {
            self.by_use.remove(used);
            self.by_use.insert(self.uses, key);
            *used = self.uses;
            return Ok(Arc::clone(value));
        }
        let (value, size) = make()?;
        let value = Arc::new(value);
        self.bytes += size;
        self.values.insert(key, (self.uses, Arc::clone(&value), size));
        self.by_use.insert(self.uses, key);
        while self.bytes > self.most_bytes && self.values.len() > 1 {
            let Some((_, oldest)) = self.by_use.pop_first() else {
                break;
            };
            self.bytes -= self.values.remove(&oldest).map_or(0, |(_, _, size)| size);
        }
        Ok(value)
    }
}

#[cfg(test)]
mod tests {
    use marf_stage::harness::Harness;

    use super::*;

    fn kept(id: &str) -> (KeptPhoto<'_>, PhotoKeys) {
        let size = PixelSize {
            width: 1648,
            height: 1200,
        };
        let hashes = vec![7, u64::MAX];
        let photo = KeptPhoto {
            id,
            instrument: Some("ZL"),
            filter: None,
            sol: Some(0),
            size,
            hashes: hashes.clone(),
            planes: Digest::from_content(id.as_bytes()),
        };
        let relation = RelationKeys {
            exposure: (id == "b").then_some(9),
            camera: (id != "b").then_some((1, u32::MAX)),
        };
        let keys = PhotoKeys {
            size,
            hashes,
            relation,
        };
        (photo, keys)
    }

    #[test]
    fn what_a_sol_added_comes_back_and_damage_is_an_error() {
        let harness = Harness::default();
        let names: Vec<String> = (0..GROUP)
            .map(|at| format!("{at:03}"))
            .chain(["b".to_owned()])
            .collect();
        let photos: Vec<_> = names.iter().map(|name| kept(name)).collect();
        let bytes = Added::write(&harness.ctx(), &photos).unwrap();
        let groups = Added::read(&bytes).unwrap();
        assert_eq!(
            groups.iter().map(|group| group.keys.len()).collect::<Vec<_>>(),
            [GROUP, 1]
        );
        for (at, (photo, keys)) in photos.iter().enumerate() {
            let added = &groups[at / GROUP];
            let group = Reader::new().group(&harness.ctx(), &added.photos).unwrap();
            assert_eq!(&group.photo(at % GROUP).unwrap(), photo);
            assert_eq!(&added.keys[at % GROUP], &(keys.clone(), photo.planes));
            assert!(group.photo(GROUP).is_err());
        }
        for (cut, after) in [(bytes.len() - 1, 64), (60, 0), (31, 0)] {
            let error = Added::read(&bytes[..cut]).unwrap_err();
            assert_eq!(
                error.to_string(),
                format!("photos kept of a sol cannot be read after the first {after}")
            );
        }
    }

    #[test]
    fn no_photos_add_no_bytes() {
        let harness = Harness::default();
        assert!(Added::write(&harness.ctx(), &[]).unwrap().is_empty());
        assert!(Added::read(&[]).unwrap().is_empty());
    }

    #[test]
    fn the_values_used_last_are_held() {
        let mut recent = Recent::new(30);
        let mut made = Vec::new();
        for key in [1, 2, 3, 1, 4, 1, 2] {
            let value = recent.get(key, || {
                made.push(key);
                Ok((key, 10))
            });
            assert_eq!(*value.unwrap(), key);
        }
        assert_eq!(
            made,
            [1, 2, 3, 4, 2],
            "4 displaces 2, which was used before 3 and 1"
        );
        assert_eq!(recent.bytes, 30);
    }
}
