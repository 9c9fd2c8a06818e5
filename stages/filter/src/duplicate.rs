//! The filter `duplicate`.

use std::cmp::Ordering;

use marf_cache::{ContentHash, manifest::Row};
use marf_scene::PhotoFacts;
use marf_stage::{Ctx, Define, Fold, Measure, Measured, ParamError, Port, Stage, StageError, Verdict, Work};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::by_hand::ByHand;
use crate::decision::Decision;
use crate::descriptor::{ViewDescriptor, take};
use crate::filter::{check_range, facts_of, undecodable};
#[cfg(test)]
use crate::guard::Guard;
use crate::relation::{Relation, processing_rank, relation_between};
use crate::similarity::{brightness_hash_distance, correlation, hash_distance, same_aspect};
use crate::stage::{OUTPUTS, PORTS};
use crate::survey::{self, Section, Surveyed, damaged, survey, unreadable};
use crate::{SECTION_VERSIONS, SECTIONS};

/// Rejects photos that show the same view as a better one, whatever their size, light and colour filter.
///
/// The better photo is, in this order: kept by hand, broad-band, in colour, calibrated radiance of several versions of
/// an exposure, sharper, larger, of the smaller id. A photo is rejected only if it is similar to one that is kept, so of
/// a chain of neighbours some are always kept; a photo of an earlier sol is preferred to one of a later sol.
pub struct Duplicate {
    params: DuplicateParams,
}

/// The rule of [`Duplicate`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema, ContentHash)]
#[serde(rename_all = "snake_case")]
pub enum DuplicateRule {
    /// Perceptual hash for candidates, correlation of gradients as proof: stereo partners and video neighbours
    /// are kept.
    Confirmed,
    /// The paper's rule: perceptual hashes of brightness closer than `max_bits`.
    Phash,
}

/// Parameters of [`Duplicate`].
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema, ContentHash)]
#[serde(default, deny_unknown_fields)]
pub struct DuplicateParams {
    /// `confirmed` (default) or `phash` (the paper).
    pub rule: DuplicateRule,
    /// Largest distance of the 64-bit hashes of two candidates, over pairs of bands, in bits.
    pub candidate_bits: u32,
    /// Smallest correlation of the gradient images of two duplicates. Copies reach 0.99, video
    /// neighbours 0.94, stereo partners 0.87.
    pub min_correlation: f64,
    /// The same for one pointing through different colour filters, by name or label. Where only camera, sol and filter
    /// are known, the mean of this and `min_correlation`.
    pub filter_correlation: f64,
    /// The same for two versions of one exposure by name (EFF, RAD, RSL): low, it only guards against wrong names.
    pub version_correlation: f64,
    /// Hashes closer than this many bits are duplicates, for `rule = "phash"`.
    pub max_bits: u32,
    /// Photos kept or rejected by hand; filled from `[keep]` and `[reject]` of the pipeline.
    pub by_hand: ByHand,
}

impl Default for DuplicateParams {
    fn default() -> Self {
        Self {
            rule: DuplicateRule::Confirmed,
            candidate_bits: 14,
            min_correlation: 0.975,
            filter_correlation: 0.8,
            version_correlation: 0.5,
            max_bits: 5,
            by_hand: ByHand::default(),
        }
    }
}

impl Define for Duplicate {
    type Params = DuplicateParams;
    const NAME: &'static str = "duplicate";
    const ABOUT: &'static str = "rejects photos that show the same view as a better one";
    const VERSION: u32 = Self::MEASURE_VERSION + Self::DECISION_VERSION;
    const PORTS: &'static [Port] = PORTS;
    const OUTPUTS: &'static [&'static str] = OUTPUTS;

    fn new(params: DuplicateParams) -> Result<Self, ParamError> {
        check_range("candidate_bits", f64::from(params.candidate_bits), 0.0, 64.0)?;
        check_range("max_bits", f64::from(params.max_bits), 0.0, 65.0)?;
        check_range("min_correlation", params.min_correlation, -1.0, 1.0)?;
        check_range("filter_correlation", params.filter_correlation, -1.0, 1.0)?;
        check_range("version_correlation", params.version_correlation, -1.0, 1.0)?;
        params.by_hand.check()?;
        Ok(Self { params })
    }
}

impl Stage for Duplicate {
    fn params(&self) -> serde_json::Value {
        marf_stage::key_params(&self.params, &[])
    }

    fn work(&self) -> Work<'_> {
        Work::Fold(self)
    }
}

impl Surveyed for Duplicate {
    const SECTION: Option<Section> = Some(Section {
        name: Self::NAME,
        version: Self::MEASURE_VERSION,
        measure: |photo| Ok(ViewDescriptor::of(photo).encode()),
    });
    #[cfg(test)]
    const GUARD: Guard = Guard {
        measures: "2 3d93d57f69c7",
        decisions: "2 8a7685578a5e",
    };
}

impl Measure for Duplicate {
    fn measure_params(&self) -> &dyn ContentHash {
        &SECTION_VERSIONS
    }

    fn shared(&self) -> Option<(&'static str, u32)> {
        Some(survey::TABLE)
    }

    /// Returns the survey of the photo; the part of this filter is a [`ViewDescriptor`] of some 12 KB.
    fn measure(&self, ctx: &Ctx<'_>, row: &Row) -> Result<Vec<u8>, StageError> {
        survey(SECTIONS, ctx, row)
    }
}

impl Fold for Duplicate {
    /// Decides on the photos of one sol; the state holds the descriptor of every photo kept so far, by sol and id.
    fn fold(
        &self,
        state: Option<&[u8]>,
        items: &[Measured<'_>],
    ) -> Result<(Vec<u8>, Vec<Verdict>), StageError> {
        let mut kept = state.map_or_else(|| Ok(Vec::new()), read_state)?;
        let earlier = kept.len();
        let read = items.iter().map(read_photo).collect::<Result<Vec<_>, _>>()?;
        let mut best_first: Vec<(usize, &ComparedPhoto)> = read
            .iter()
            .enumerate()
            .filter_map(|(at, item)| item.as_ref().ok().map(|photo| (at, photo)))
            .collect();
        let kept_by_hand = |photo: &ComparedPhoto| self.params.by_hand.keeps(&photo.id, &photo.facts.file);
        best_first.sort_by(|a, b| {
            kept_by_hand(b.1)
                .cmp(&kept_by_hand(a.1))
                .then_with(|| a.1.compare_quality(b.1))
        });
        let mut verdicts: Vec<Option<Verdict>> =
            read.iter().map(|item| item.as_ref().err().cloned()).collect();
        for (at, photo) in best_first {
            let decision = self.decide(photo, &kept);
            let decision = self
                .params
                .by_hand
                .overrule(&photo.id, &photo.facts.file, decision);
            if decision.keep {
                kept.push(photo.clone());
            }
            verdicts[at] = Some(decision.verdict(Self::NAME, items[at].row, &photo.facts));
        }
        kept[earlier..].sort_by(|a, b| a.id.cmp(&b.id));
        // Every photo either has the verdict of the decoder or has been decided on, so `flatten` drops none.
        Ok((write_state(&kept), verdicts.into_iter().flatten().collect()))
    }
}

/// A photo with what it is compared by.
#[derive(Debug, Clone)]
struct ComparedPhoto {
    id: String,
    facts: PhotoFacts,
    descriptor: ViewDescriptor,
}

/// A photo whose [`ViewDescriptor::colour`] is below this has one tint: narrow-band JPEG copies have 0.0025 to 0.0095,
/// the palest photo of the Navcam feed 0.021, rover and fox 0.087 and more.
const MIN_COLOUR: f64 = 0.014;

impl ComparedPhoto {
    /// Orders the better photo first; ids are unique, so no two photos are equal.
    fn compare_quality(&self, other: &Self) -> Ordering {
        let area = |photo: &Self| u64::from(photo.descriptor.width) * u64::from(photo.descriptor.height);
        other
            .is_broad()
            .cmp(&self.is_broad())
            .then_with(|| {
                (other.descriptor.colour >= MIN_COLOUR).cmp(&(self.descriptor.colour >= MIN_COLOUR))
            })
            .then_with(|| processing_rank(&self.id).cmp(&processing_rank(&other.id)))
            .then_with(|| other.descriptor.sharpness.total_cmp(&self.descriptor.sharpness))
            .then_with(|| area(other).cmp(&area(self)))
            .then_with(|| self.id.cmp(&other.id))
    }

    /// Returns whether the archive names no colour filter, or a broad-band one: `0` of the science cameras, `F` (full
    /// colour), `E` (its mosaic) and `M` (panchromatic) of the engineering cameras of Mars 2020.
    fn is_broad(&self) -> bool {
        self.facts
            .filter
            .as_deref()
            .is_none_or(|filter| matches!(filter, "0" | "UNK" | "" | "F" | "E" | "M"))
    }
}

impl Duplicate {
    /// As [`Filter::MEASURE_VERSION`](crate::Filter::MEASURE_VERSION).
    const MEASURE_VERSION: u32 = 2;
    /// As [`Filter::DECISION_VERSION`](crate::Filter::DECISION_VERSION).
    const DECISION_VERSION: u32 = 0;

    /// Decides on a photo by comparing it with all kept ones; the reason names the most similar one, of equals the first.
    fn decide(&self, photo: &ComparedPhoto, kept: &[ComparedPhoto]) -> Decision {
        let mut nearest: Option<(f64, Decision)> = None;
        for other in kept
            .iter()
            .filter(|other| same_aspect(&photo.descriptor, &other.descriptor))
        {
            let compared = match self.params.rule {
                DuplicateRule::Confirmed => self.compare_gradients(photo, other),
                DuplicateRule::Phash => Some(self.compare_hashes(photo, other)),
            };
            if let Some((excess, decision)) = compared
                && nearest.as_ref().is_none_or(|(most, _)| excess > *most)
            {
                nearest = Some((excess, decision));
            }
        }
        nearest.map_or_else(|| Decision::pass(""), |(_, decision)| decision)
    }

    /// Compares by hashes and gradients: returns by how much the score exceeds the threshold, and the decision; `None`
    /// where the hashes are too far apart.
    fn compare_gradients(&self, photo: &ComparedPhoto, other: &ComparedPhoto) -> Option<(f64, Decision)> {
        let bits = hash_distance(&photo.descriptor, &other.descriptor);
        let relation = relation_between((&photo.id, &photo.facts), (&other.id, &other.facts));
        if bits > self.params.candidate_bits && relation == Relation::Unknown {
            return None;
        }
        let limit = self.min_correlation(relation);
        let score = correlation(&photo.descriptor, &other.descriptor);
        let reason = || {
            let (twin, words) = (&other.id, relation.reason_suffix());
            format!(
                "like `{twin}`: gradients correlate {score:.3}, at least {limit}, hashes {bits} bits apart{words}"
            )
        };
        Some((
            score - limit,
            compared(score >= limit, score, limit, reason, other),
        ))
    }

    /// Returns the smallest correlation of two duplicates that are related like this.
    fn min_correlation(&self, relation: Relation) -> f64 {
        let (usual, filter) = (self.params.min_correlation, self.params.filter_correlation);
        let limit = match relation {
            Relation::SameExposure => self.params.version_correlation,
            Relation::SamePointing => filter,
            Relation::SameCamera => (usual + filter) / 2.0,
            Relation::Unknown => usual,
        };
        limit.min(usual)
    }

    /// Compares by the hashes of the brightness alone, as [`Duplicate::compare_gradients`] does.
    fn compare_hashes(&self, photo: &ComparedPhoto, other: &ComparedPhoto) -> (f64, Decision) {
        let (bits, limit) = (
            brightness_hash_distance(&photo.descriptor, &other.descriptor),
            self.params.max_bits,
        );
        let (score, threshold) = (f64::from(bits), f64::from(limit));
        let reason = || format!("like `{}`: hashes {bits} bits apart, less than {limit}", other.id);
        (
            threshold - score,
            compared(bits < limit, score, threshold, reason, other),
        )
    }
}

/// Returns the decision on a photo that was compared with `other`.
fn compared(
    alike: bool,
    score: f64,
    limit: f64,
    reason: impl Fn() -> String,
    other: &ComparedPhoto,
) -> Decision {
    if !alike {
        return Decision {
            reason: format!("nearest is `{}`", other.id),
            ..Decision::keep(score, limit)
        };
    }
    Decision {
        twin: Some(other.id.clone()),
        ..Decision::reject(score, limit, reason())
    }
}

/// Reads a photo with its descriptor; the inner error is the verdict of a photo that could not be decoded.
fn read_photo(item: &Measured<'_>) -> Result<Result<ComparedPhoto, Verdict>, StageError> {
    let facts = facts_of(item.row)?;
    match survey::part(item.measure, Duplicate::NAME, item.row)? {
        Ok(mut descriptor) => {
            let descriptor = ViewDescriptor::decode(&mut descriptor)
                .ok_or_else(|| unreadable(item.row, "it is no descriptor"))?;
            let id = item.row.id.clone();
            Ok(Ok(ComparedPhoto {
                id,
                facts,
                descriptor,
            }))
        }
        Err(reason) => Ok(Err(undecodable(item.row, &facts, reason))),
    }
}

/// Writes, for each photo, a length and a JSON header (u32 LE first), then its descriptor.
fn write_state(kept: &[ComparedPhoto]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for photo in kept {
        let head = StateHeader {
            id: photo.id.clone(),
            instrument: photo.facts.instrument.clone(),
            filter: photo.facts.filter.clone(),
            sol: photo.facts.sol,
        };
        // Strings and numbers always serialise; an empty header would be refused on reading.
        let head = serde_json::to_vec(&head).unwrap_or_default();
        bytes.extend((head.len() as u32).to_le_bytes());
        bytes.extend(head);
        bytes.extend(photo.descriptor.encode());
    }
    bytes
}

/// The facts of a kept photo that later sols need beside its descriptor.
#[derive(Serialize, Deserialize)]
struct StateHeader {
    id: String,
    instrument: Option<String>,
    filter: Option<String>,
    sol: Option<u32>,
}

/// Reads what [`write_state`] wrote.
fn read_state(mut bytes: &[u8]) -> Result<Vec<ComparedPhoto>, StageError> {
    let mut kept = Vec::new();
    while !bytes.is_empty() {
        let photo = read_kept(&mut bytes);
        kept.push(photo.ok_or_else(|| damaged(format!("state cannot be read after {} photos", kept.len())))?);
    }
    Ok(kept)
}

/// Reads one photo and removes it from the front of `bytes`; `None` if it is not that.
fn read_kept(bytes: &mut &[u8]) -> Option<ComparedPhoto> {
    let length = u32::from_le_bytes(take(bytes)?) as usize;
    let (head, rest) = bytes.split_at_checked(length)?;
    *bytes = rest;
    let head: StateHeader = serde_json::from_slice(head).ok()?;
    let facts = PhotoFacts {
        instrument: head.instrument,
        filter: head.filter,
        sol: head.sol,
        ..PhotoFacts::default()
    };
    let descriptor = ViewDescriptor::decode(bytes)?;
    Some(ComparedPhoto {
        id: head.id,
        facts,
        descriptor,
    })
}
