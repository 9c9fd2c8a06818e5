//! Which photos show the same, without solving for cameras.

use marf_schema::calibrate::CalibrateParams;
use marf_sfm_features::two_view::VerifiedKind;
use marf_stage::{Ctx, Inputs, StageError};

use super::cameras;
use super::capture_order::capture_order;
use super::compare::{Comparison, choose};
use super::photo_features::photo_features;
use crate::labels;
use crate::photos::InputPhoto;

/// Two photos that show the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Overlap {
    /// Indices of the photos, the lower first.
    pub photos: [usize; 2],
    /// Matches that agree with one rigid scene.
    pub matches: u32,
    /// Whether they show depth: not a plane, and not a camera that only turned.
    pub has_depth: bool,
}

/// Returns the pairs of photos that verified matches link. Features and matches are those that `calibrate` keeps with the same
/// parameters, so that it finds them done.
///
/// # Errors
/// A photo that cannot be read, the wish to stop.
pub(crate) fn overlaps(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    items: &[InputPhoto],
    params: &CalibrateParams,
) -> Result<Vec<Overlap>, StageError> {
    let candidates = items.iter().enumerate();
    let candidates: Vec<_> = candidates
        .map(|(index, item)| labels::candidate(index, item).ok())
        .collect();
    let features = photo_features(ctx, inputs, items, &candidates, params)?;
    let (shared, views) = cameras::group(items, &features, params);
    let pairs = choose(ctx, &features, &capture_order(items), params)?;
    let comparison = Comparison {
        features: &features,
        views: &views,
        cameras: &shared,
        params,
    };
    let compared = comparison.run(ctx, &pairs)?;
    let found = compared.iter().filter_map(|pair| {
        let matches = pair.verified.inliers.len() as u32;
        let is_rigid = matches!(pair.verified.kind, VerifiedKind::General | VerifiedKind::Planar);
        (is_rigid && matches >= params.min_matches).then_some(Overlap {
            photos: pair.photos,
            matches,
            has_depth: pair.verified.kind == VerifiedKind::General,
        })
    });
    Ok(found.collect())
}
