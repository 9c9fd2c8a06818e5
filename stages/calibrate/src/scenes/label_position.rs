//! Where a label says that a photo was taken.

use nalgebra::Vector3;

use crate::labels;
use crate::photos::InputPhoto;

/// Where a label says that a photo was taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LabelPosition {
    pub site: i64,
    pub drive: Option<i64>,
    /// The camera in the site's frame, metres: north, east, down.
    pub centre: Vector3<f64>,
}

impl LabelPosition {
    /// Returns where a photo was taken, if its label has a site and a position there.
    pub(super) fn from_photo(index: usize, item: &InputPhoto) -> Option<Self> {
        let candidate = labels::candidate(index, item).ok()?;
        let counter = &item.facts.prior.as_ref()?.motion_counter;
        let centre = candidate.site_from_frame.point(&Vector3::from(candidate.model.c));
        let is_finite = centre.iter().all(|metres| metres.is_finite());
        is_finite.then_some(Self {
            site: candidate.site?,
            drive: counter.get(1).copied(),
            centre,
        })
    }
}
