//! A photo of the sol that `duplicate` decides on.

use std::cmp::Ordering;

use marf_cache::{Digest, manifest::Row};
use marf_stage::{Measured, StageError, Verdict};

use crate::by_hand::ByHand;
use crate::bytes::from_bytes;
use crate::candidates::PhotoKeys;
use crate::decision::undecodable;
use crate::descriptor::ViewDescriptor;
use crate::facts::Facts;
use crate::kept::KeptPhoto;
use crate::relation::{Relative, processing_rank};
use crate::section::{measured, unreadable};

/// A photo of the sol that is decided on.
#[derive(Debug)]
pub(super) struct ComparedPhoto<'a> {
    pub(super) row: &'a Row,
    pub(super) facts: Facts<'a>,
    pub(super) keys: PhotoKeys,
    /// Digest of the gradient planes.
    pub(super) planes: Digest,
    sharpness: f64,
    colour: f64,
    kept_by_hand: bool,
    processing_rank: u8,
}

/// A photo whose [`ViewDescriptor::colour`] is below this has one tint. Narrow-band JPEG copies have 0.0025 to
/// 0.0095, the palest photo of the Navcam feed 0.021, rover and fox 0.087 and more.
const MIN_COLOUR: f64 = 0.014;

impl<'a> ComparedPhoto<'a> {
    /// Reads a photo with its descriptor. The inner error is the verdict of a photo that could not be decoded.
    pub(super) fn read(item: &Measured<'a>, by_hand: &ByHand) -> Result<Result<Self, Verdict>, StageError> {
        let facts = Facts::from_row(item.row)?;
        let descriptor = match measured(item.measure, item.row)? {
            Ok(descriptor) => from_bytes::<ViewDescriptor>(descriptor),
            Err(reason) => return Ok(Err(undecodable(item.row, &facts, reason))),
        };
        let descriptor = descriptor.ok_or_else(|| unreadable(item.row, "it is not a descriptor"))?;
        Ok(Ok(Self {
            row: item.row,
            keys: PhotoKeys {
                size: descriptor.size,
                hashes: descriptor.hashes,
                relation: Relative::from_row(item.row, &facts).keys(),
            },
            planes: descriptor.planes,
            sharpness: descriptor.sharpness,
            colour: descriptor.colour,
            kept_by_hand: by_hand.keeps(&item.row.id, facts.file),
            processing_rank: processing_rank(&item.row.id),
            facts,
        }))
    }

    pub(super) fn id(&self) -> &'a str {
        &self.row.id
    }

    pub(super) fn relative(&self) -> Relative<'a> {
        Relative::from_row(self.row, &self.facts)
    }

    /// Returns the data that photos of this sol and of later ones compare it by.
    pub(super) fn kept(&self) -> KeptPhoto<'a> {
        KeptPhoto {
            id: self.id(),
            instrument: self.facts.instrument,
            filter: self.facts.filter,
            sol: self.facts.sol,
            keys: self.keys.clone(),
            planes: self.planes,
        }
    }

    /// Orders the better photo first. Ids are unique, so no two photos are equal.
    pub(super) fn compare_quality(&self, other: &Self) -> Ordering {
        let area = |photo: &Self| u64::from(photo.keys.size.width) * u64::from(photo.keys.size.height);
        (other.kept_by_hand.cmp(&self.kept_by_hand))
            .then_with(|| other.is_broad().cmp(&self.is_broad()))
            .then_with(|| (other.colour >= MIN_COLOUR).cmp(&(self.colour >= MIN_COLOUR)))
            .then_with(|| self.processing_rank.cmp(&other.processing_rank))
            .then_with(|| other.sharpness.total_cmp(&self.sharpness))
            .then_with(|| area(other).cmp(&area(self)))
            .then_with(|| self.id().cmp(other.id()))
    }

    /// Whether the archive names no colour filter, or a broad-band one. Those are `0` of the science cameras, and `F`
    /// (full colour), `E` (its mosaic) and `M` (panchromatic) of the engineering cameras of Mars 2020.
    fn is_broad(&self) -> bool {
        self.facts
            .filter
            .is_none_or(|filter| matches!(filter, "0" | "UNK" | "" | "F" | "E" | "M"))
    }
}
