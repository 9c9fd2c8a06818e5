//! The edges of the view graph, computed or from the memos.

use marf_cache::{Digest, digest_of};
use marf_scene::Pose;
use marf_schema::calibrate::CalibrateParams;
use marf_sfm::view_graph::{ComparedPair, Link, SharedCamera, View, link_pair};
use marf_sfm_features::two_view::{RelativePose, RelativePoseKind};
use marf_stage::{Ctx, StageError};
use nalgebra::{Matrix3, Vector3};

use super::compare::{names, pack_inliers, photos_key, seed_of, unpack_inliers};
use super::pair_memos::{PairFunction, map_pairs};
use super::photo_features::PhotoFeatures;

/// Raised when relative poses may change.
const VERSION: u32 = 1;

/// Relative poses of compared pairs, with the cameras as the pairs have refined them.
pub(super) struct PairLinks<'a> {
    pub features: &'a [PhotoFeatures],
    pub views: &'a [View],
    pub cameras: &'a [SharedCamera],
    /// Sorted by photos.
    pub compared: &'a [ComparedPair],
    pub params: &'a CalibrateParams,
}

impl PairLinks<'_> {
    /// Returns the edges of the pairs that have one.
    ///
    /// # Errors
    /// A request to stop.
    pub(super) fn run(&self, ctx: &Ctx<'_>) -> Result<Vec<Link>, StageError> {
        // Others have no edge.
        let verified = self
            .compared
            .iter()
            .filter(|pair| pair.verified.inliers.len() >= self.params.min_matches as usize);
        let pairs: Vec<[usize; 2]> = verified.map(|pair| pair.photos).collect();
        let found = map_pairs(ctx, &names(self.features), &pairs, self)?;
        Ok(found.into_iter().flatten().collect())
    }

    /// Returns the verified matches of a pair.
    fn verified(&self, photos: [usize; 2]) -> Option<&ComparedPair> {
        let place = self.compared.binary_search_by_key(&photos, |pair| pair.photos);
        self.compared.get(place.ok()?)
    }

    /// Returns a seed that depends on the verified matches of a pair alone.
    fn seed(&self, pair: &ComparedPair) -> u64 {
        seed_of(&Digest::from_content(&pack_inliers(&pair.verified.inliers))) ^ self.params.seed
    }
}

impl PairFunction for PairLinks<'_> {
    type Output = Option<Link>;
    const NOTE: &'static str = "relative poses";

    fn table(&self) -> Digest {
        digest_of(&("calibrate links", VERSION, self.params.min_matches))
    }

    fn key(&self, photos: [usize; 2]) -> Digest {
        let pair = photos_key(photos, self.features, self.views, self.cameras);
        let inliers = self
            .verified(photos)
            .map(|pair| pack_inliers(&pair.verified.inliers));
        digest_of(&(pair, inliers, self.params.seed))
    }

    fn compute(&self, photos: [usize; 2], _key: &Digest) -> Option<Link> {
        let pair = self.verified(photos)?;
        let least = self.params.min_matches as usize;
        link_pair(self.views, self.cameras, pair, least, self.seed(pair))
    }

    fn pack(&self, found: &Option<Link>) -> Vec<u8> {
        found
            .as_ref()
            .map_or_else(Vec::new, |link| pack(&link.relative_pose))
    }

    fn unpack(&self, photos: [usize; 2], row: &[u8]) -> Option<Option<Link>> {
        if row.is_empty() {
            return Some(None);
        }
        let relative_pose = unpack(row)?;
        Some(Some(Link {
            photos,
            relative_pose,
        }))
    }
}

/// Kinds of relative poses by their numbers in a row.
const KINDS: [RelativePoseKind; 3] = [
    RelativePoseKind::General,
    RelativePoseKind::Planar,
    RelativePoseKind::Rotation,
];

/// Returns a relative pose as bytes: kind, rotation, translation, angle, forward part, inliers, all little-endian.
fn pack(pose: &RelativePose) -> Vec<u8> {
    let kind = KINDS
        .iter()
        .position(|kind| *kind == pose.kind)
        .unwrap_or_default();
    let Pose {
        rotation,
        translation,
    } = &pose.cam2_from_cam1;
    let numbers = rotation.iter().chain(translation.iter());
    let numbers = numbers.chain([&pose.median_angle_rad, &pose.forward]);
    let mut bytes = vec![kind as u8];
    bytes.extend(numbers.flat_map(|number| number.to_le_bytes()));
    bytes.extend(pack_inliers(&pose.inliers));
    bytes
}

/// Reads what [`pack`] wrote.
fn unpack(row: &[u8]) -> Option<RelativePose> {
    let (&kind, rest) = row.split_first()?;
    let (numbers, inliers) = rest.split_at_checked(14 * 8)?;
    let numbers = numbers.as_chunks::<8>().0.iter();
    let numbers: Vec<f64> = numbers.map(|number| f64::from_le_bytes(*number)).collect();
    Some(RelativePose {
        kind: *KINDS.get(usize::from(kind))?,
        cam2_from_cam1: Pose {
            rotation: Matrix3::from_column_slice(&numbers[..9]),
            translation: Vector3::from_column_slice(&numbers[9..12]),
        },
        median_angle_rad: numbers[12],
        forward: numbers[13],
        inliers: unpack_inliers(inliers)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_relative_pose_comes_back_to_the_bit_and_a_cut_one_does_not() {
        let pose = RelativePose {
            kind: RelativePoseKind::Planar,
            cam2_from_cam1: Pose {
                rotation: Matrix3::new(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 0.1 + 0.2),
                translation: Vector3::new(-0.0, 1e-300, 1.0),
            },
            inliers: vec![[1, 2], [u32::MAX, 4]],
            median_angle_rad: 0.1,
            forward: 0.25,
        };
        let row = pack(&pose);
        let found = unpack(&row).unwrap();
        assert_eq!(pack(&found), row);
        assert_eq!(
            (found.kind, found.cam2_from_cam1, found.inliers),
            (pose.kind, pose.cam2_from_cam1, pose.inliers)
        );
        for length in [0, 1, 112, row.len() - 1] {
            assert!(unpack(&row[..length]).is_none(), "{length}");
        }
    }
}
