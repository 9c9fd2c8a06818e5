//! The comparison of a photo with its candidates, one by one.

use std::sync::Arc;

use marf_cache::manifest::Row;
use marf_stage::{Ctx, StageError};

use super::photo::ComparedPhoto;
use super::rule::{Duplicate, compared};
use crate::decision::Decision;
use crate::kept::{KeptPhoto, PlanesReader};
use crate::relation::{Relation, Relative, relation_between};
use crate::similarity::{Planes, correlation, hash_distance, same_aspect};

/// The comparison of a photo with its candidates.
pub(super) struct Nearest<'a> {
    duplicate: &'a Duplicate,
    photo: &'a ComparedPhoto<'a>,
    /// The planes of the photo, once a candidate needs them.
    planes: Option<Arc<Planes>>,
    /// By how much the score of the most similar one so far exceeds its threshold, and the decision.
    found: Option<(f64, Decision)>,
}

impl<'a> Nearest<'a> {
    /// Returns the comparison of a photo with nothing so far.
    pub(super) fn new(duplicate: &'a Duplicate, photo: &'a ComparedPhoto<'a>) -> Self {
        Self {
            duplicate,
            photo,
            planes: None,
            found: None,
        }
    }

    /// Returns the decision by the most similar candidate.
    pub(super) fn decision(self) -> Decision {
        self.found
            .map_or_else(|| Decision::pass(""), |(_, decision)| decision)
    }

    /// Compares with one candidate by hashes and gradients. It does not count if its hashes are too far apart, unless
    /// the photos are related.
    pub(super) fn compare(
        &mut self,
        ctx: &Ctx<'_>,
        reader: &mut PlanesReader,
        other: &KeptPhoto<'_>,
        row: Option<&Row>,
    ) -> Result<(), StageError> {
        if !same_aspect(self.photo.keys.size, other.keys.size) {
            return Ok(());
        }
        let params = &self.duplicate.params;
        let bits = hash_distance(&self.photo.keys.hashes, &other.keys.hashes);
        let relative = Relative {
            row,
            ..other.relative()
        };
        let relation = relation_between(&self.photo.relative(), &relative);
        if bits > params.candidate_bits && relation == Relation::Unknown {
            return Ok(());
        }
        let limit = self.duplicate.min_correlation(relation);
        if self
            .found
            .as_ref()
            .is_some_and(|(most, _)| MAX_CORRELATION - limit <= *most)
        {
            return Ok(());
        }
        let own = match &self.planes {
            Some(planes) => planes,
            None => self.planes.insert(reader.read(ctx, &self.photo.planes)?),
        };
        let score = correlation(own, &*reader.read(ctx, &other.planes)?);
        let excess = score - limit;
        if self.found.as_ref().is_some_and(|(most, _)| excess <= *most) {
            return Ok(());
        }
        let reason = || {
            let (twin, words) = (other.id, relation.reason_suffix());
            format!(
                "like `{twin}`: gradients correlate {score:.3}, at least {limit}, hashes {bits} bits apart{words}"
            )
        };
        self.found = Some((excess, compared(score >= limit, score, limit, reason, other.id)));
        Ok(())
    }
}

/// No correlation is larger: 1, and the rounding of two roots, a product and a quotient.
const MAX_CORRELATION: f64 = 1.0 + 4.0 * f64::EPSILON;
