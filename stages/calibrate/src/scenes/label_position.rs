//! Where a label says that a photo was taken.

use nalgebra::Vector3;

use crate::labels;
use crate::photos::InputPhoto;

/// Where a label says that a photo was taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LabelPosition {
    pub site: i64,
    pub drive: Option<i64>,
    /// The camera, or the rover of a label without a usable one, in the site's frame, metres: north, east, down.
    pub centre: Vector3<f64>,
}

impl LabelPosition {
    /// Returns where a photo was taken, if its label has a site and a position there.
    pub(super) fn from_photo(index: usize, item: &InputPhoto) -> Option<Self> {
        let counter = item.facts.motion_counter();
        let centre = match (labels::candidate(index, item), &item.facts.place) {
            (Ok(candidate), _) => candidate.site_from_frame.point(&Vector3::from(candidate.model.c)),
            // Without a usable camera the photo is where the rover stood.
            (Err(_), Some(place)) => place.site_from_frame?.translation,
            (Err(_), None) => return None,
        };
        let is_finite = centre.iter().all(|metres| metres.is_finite());
        is_finite.then_some(Self {
            site: counter.first().copied()?,
            drive: counter.get(1).copied(),
            centre,
        })
    }
}
