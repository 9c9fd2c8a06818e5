//! The edges of the view graph, computed or from the memos.

use marf_cache::{Digest, digest_of};
use marf_schema::calibrate::CalibrateParams;
use marf_sfm::view_graph::{ComparedPair, Link, SharedCamera, View, link_pair};
use marf_sfm_features::two_view::RelativePose;
use marf_stage::{Ctx, StageError};

use super::compare::{names, pack_inliers, photos_key, seed_of};
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
        let links = pairs.into_iter().zip(found).filter_map(|(photos, found)| {
            let relative_pose = found?;
            Some(Link {
                photos,
                relative_pose,
            })
        });
        Ok(links.collect())
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
    type Output = Option<RelativePose>;
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

    fn compute(&self, photos: [usize; 2], _key: &Digest) -> Option<RelativePose> {
        let pair = self.verified(photos)?;
        let least = self.params.min_matches as usize;
        let link = link_pair(self.views, self.cameras, pair, least, self.seed(pair))?;
        Some(link.relative_pose)
    }
}
