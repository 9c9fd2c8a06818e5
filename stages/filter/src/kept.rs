//! The photos that `duplicate` has kept of earlier sols, as each sol added them. Every later run reads them whole. The planes of a
//! photo are a blob of their own, which is read when the photo is a candidate.

use std::collections::BTreeMap;
use std::sync::Arc;

use marf_cache::Digest;
use marf_stage::{Ctx, StageError};
use serde::{Deserialize, Serialize};

use crate::bytes::{digest, from_bytes, to_bytes};
use crate::candidates::PhotoKeys;
use crate::relation::Relative;
use crate::section::damaged;
use crate::similarity::Planes;

/// A photo that was kept: what photos of later sols find it by and compare it by. With a name of Mars 2020 it takes
/// 130 bytes with one hash and 160 with four.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct KeptPhoto<'a> {
    pub(crate) id: &'a str,
    #[serde(borrow)]
    pub(crate) instrument: Option<&'a str>,
    #[serde(borrow)]
    pub(crate) filter: Option<&'a str>,
    pub(crate) sol: Option<u32>,
    pub(crate) keys: PhotoKeys,
    /// Digest of the gradient planes.
    #[serde(with = "digest")]
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
}

/// The photos kept so far, each at the position of its insertion and as bytes, which take half the memory.
#[derive(Default)]
pub(crate) struct KeptPhotos(Vec<Box<[u8]>>);

impl KeptPhotos {
    /// Adds a photo at the next position.
    ///
    /// # Errors
    /// A photo that cannot be written.
    pub(crate) fn insert(&mut self, photo: &KeptPhoto<'_>) -> Result<(), StageError> {
        self.0.push(to_bytes(photo)?.into());
        Ok(())
    }

    /// Returns the photo at a position.
    ///
    /// # Errors
    /// A position without a photo.
    pub(crate) fn photo(&self, position: u32) -> Result<KeptPhoto<'_>, StageError> {
        let bytes = self.0.get(position as usize);
        let photo = bytes.and_then(|bytes| from_bytes(bytes));
        photo.ok_or_else(unreadable)
    }
}

/// Reads the photos that a sol added.
///
/// # Errors
/// Bytes that are not those of photos.
pub(crate) fn read_added(added: &[u8]) -> Result<Vec<KeptPhoto<'_>>, StageError> {
    from_bytes(added).ok_or_else(unreadable)
}

fn unreadable() -> StageError {
    damaged("photos kept of a sol cannot be read".to_owned())
}

/// Most bytes of planes that are held: those of 500 photos of three bands.
const PLANES_BYTES: usize = 16 << 20;

/// Reads gradient planes, and holds the most recently used.
pub(crate) struct PlanesReader {
    planes: BTreeMap<Digest, (u64, Arc<Planes>)>,
    by_use: BTreeMap<u64, Digest>,
    uses: u64,
    bytes: usize,
    most_bytes: usize,
}

impl PlanesReader {
    /// Returns a reader that holds none yet.
    pub(crate) fn new() -> Self {
        Self {
            planes: BTreeMap::new(),
            by_use: BTreeMap::new(),
            uses: 0,
            bytes: 0,
            most_bytes: PLANES_BYTES,
        }
    }

    /// Returns the gradient planes of a photo.
    ///
    /// # Errors
    /// A blob that is lost or damaged.
    pub(crate) fn read(&mut self, ctx: &Ctx<'_>, digest: &Digest) -> Result<Arc<Planes>, StageError> {
        self.uses += 1;
        if let Some((used, planes)) = self.planes.get_mut(digest) {
            self.by_use.remove(used);
            self.by_use.insert(self.uses, *digest);
            *used = self.uses;
            return Ok(Arc::clone(planes));
        }
        let planes = Planes::read(&ctx.get(digest)?);
        let planes =
            planes.ok_or_else(|| damaged(format!("gradient planes {} cannot be read", digest.short())))?;
        let planes = Arc::new(planes);
        self.bytes += planes.size_bytes();
        self.planes.insert(*digest, (self.uses, Arc::clone(&planes)));
        self.by_use.insert(self.uses, *digest);
        while self.bytes > self.most_bytes && self.planes.len() > 1 {
            let Some((_, oldest)) = self.by_use.pop_first() else {
                break;
            };
            let gone = self.planes.remove(&oldest);
            self.bytes -= gone.map_or(0, |(_, planes)| planes.size_bytes());
        }
        Ok(planes)
    }
}

#[cfg(test)]
mod tests {
    use marf_stage::harness::Harness;

    use super::*;
    use crate::descriptor::{CELLS, PixelSize};
    use crate::relation::RelationKeys;

    fn kept(id: &str) -> KeptPhoto<'_> {
        KeptPhoto {
            id,
            instrument: Some("ZL"),
            filter: None,
            sol: Some(0),
            keys: PhotoKeys {
                size: PixelSize {
                    width: 1648,
                    height: 1200,
                },
                hashes: vec![7, u64::MAX],
                relation: RelationKeys {
                    exposure: (id == "b").then_some(9),
                    camera: (id != "b").then_some((1, u32::MAX)),
                },
            },
            planes: Digest::from_content(id.as_bytes()),
        }
    }

    #[test]
    fn what_a_sol_added_comes_back_and_damage_is_an_error() {
        let photos = ["", "a", "b"].map(kept);
        let bytes = to_bytes(&photos.to_vec()).unwrap();
        assert_eq!(read_added(&bytes).unwrap(), photos);
        let mut all = KeptPhotos::default();
        photos.iter().for_each(|photo| all.insert(photo).unwrap());
        for (at, photo) in (0..).zip(&photos) {
            assert_eq!(&all.photo(at).unwrap(), photo);
        }
        assert!(all.photo(3).is_err());
        for cut in 0..bytes.len() {
            let error = read_added(&bytes[..cut]).unwrap_err();
            assert_eq!(
                error.to_string(),
                "photos kept of a sol cannot be read",
                "cut at {cut}"
            );
        }
    }

    /// The size that decides how many photos fit in memory.
    #[test]
    fn a_photo_of_mars_2020_with_four_hashes_takes_less_than_200_bytes() {
        let mut photo = kept("ZL0_0709_0729888971_069RAD_N0332864ZCAM07114_0340LMA01");
        photo.filter = Some("0");
        photo.sol = Some(709);
        photo.keys.hashes = vec![u64::MAX; 4];
        photo.keys.relation.exposure = Some(u32::MAX);
        let bytes = to_bytes(&photo).unwrap().len();
        assert!((150..200).contains(&bytes), "{bytes} bytes");
    }

    #[test]
    fn the_planes_used_last_are_held() {
        let harness = Harness::default();
        let planes = [1, 2, 3, 4].map(|value| harness.put(&[value; CELLS * CELLS]));
        let mut reader = PlanesReader::new();
        reader.most_bytes = 3 * reader.read(&harness.ctx(), &planes[0]).unwrap().size_bytes();
        for at in [1, 2, 0, 3, 0, 1] {
            reader.read(&harness.ctx(), &planes[at]).unwrap();
        }
        assert_eq!(
            planes.map(|digest| harness.reads(&digest)),
            [1, 2, 1, 1],
            "the fourth displaces the second, which was used before the third and the first"
        );
        assert_eq!(reader.bytes, reader.most_bytes);
    }
}
