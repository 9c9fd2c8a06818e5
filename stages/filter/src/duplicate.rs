use std::cmp::Ordering;

use marf_cache::{ContentHash, manifest::Row};
use marf_scene::PhotoFacts;
use marf_stage::{Ctx, Define, Fold, Measure, Measured, ParamError, Port, Stage, StageError, Verdict, Work};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::by_hand::ByHand;
use crate::descriptor::{ViewDescriptor, take};
use crate::filter::{Decision, check_range, facts_of, undecodable};
use crate::relation::{Relation, processing_rank, relation_between};
use crate::similarity::{bits, brightness_bits, correlation, same_aspect};
use crate::stage::{OUTPUTS, PORTS};
use crate::survey::{self, Section, Surveyed, survey, unreadable};
use crate::{SECTIONS, VERSIONS};

/// Rejects photos that show the same view as a better one, up to size, light and colour filter.
///
/// Best first: kept by hand, broad-band before narrow-band, colour before gray, radiance before other versions of an
/// exposure, then sharpest, largest, smallest id. A photo goes only if it is itself like one that stays, so a chain of
/// neighbours is never lost; and a photo of an earlier sol always stays before one of a later sol.
pub struct Duplicate {
    params: DuplicateParams,
}

/// How [`Duplicate`] judges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema, ContentHash)]
#[serde(rename_all = "snake_case")]
pub enum DuplicateRule {
    /// Perceptual hash for candidates, correlation of gradients as proof: stereo partners and video neighbours
    /// stay.
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
    /// Photos on which a person has decided; filled from `[keep]` and `[reject]` of the pipeline.
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
    const VERSION: u32 = 2;
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
    fn params(&self) -> &dyn ContentHash {
        &self.params
    }

    fn work(&self) -> Work<'_> {
        Work::Fold(self)
    }
}

impl Surveyed for Duplicate {
    const SECTION: Option<Section> = Some(Section {
        name: Self::NAME,
        version: Self::VERSION,
        measure: |look| Ok(ViewDescriptor::of(look).encode()),
    });
}

impl Measure for Duplicate {
    fn measure_params(&self) -> &dyn ContentHash {
        &VERSIONS
    }

    fn shared(&self) -> Option<(&'static str, u32)> {
        Some(survey::TABLE)
    }

    /// Returns the survey of the photo; its part for this filter is a sketch of some 12 KB.
    fn measure(&self, ctx: &Ctx<'_>, row: &Row) -> Result<Vec<u8>, StageError> {
        survey(SECTIONS, ctx, row)
    }
}

impl Fold for Duplicate {
    /// The state holds what is needed of every photo kept so far, sol by sol, sorted by id within a sol.
    fn fold(
        &self,
        state: Option<&[u8]>,
        items: &[Measured<'_>],
    ) -> Result<(Vec<u8>, Vec<Verdict>), StageError> {
        let mut kept = state.map_or_else(|| Ok(Vec::new()), read_state)?;
        let earlier = kept.len();
        let read = items.iter().map(read_item).collect::<Result<Vec<_>, _>>()?;
        let mut best_first: Vec<(usize, &ComparedPhoto)> = read
            .iter()
            .enumerate()
            .filter_map(|(at, item)| item.as_ref().ok().map(|view| (at, view)))
            .collect();
        let wanted = |view: &ComparedPhoto| self.params.by_hand.keeps(&view.id, &view.facts.file);
        best_first.sort_by(|a, b| wanted(b.1).cmp(&wanted(a.1)).then_with(|| a.1.better(b.1)));
        let mut verdicts: Vec<Option<Verdict>> =
            read.iter().map(|item| item.as_ref().err().cloned()).collect();
        for (at, view) in best_first {
            let decision = self.judge(view, &kept);
            let decision = self.params.by_hand.overrule(&view.id, &view.facts.file, decision);
            if decision.keep {
                kept.push(view.clone());
            }
            verdicts[at] = Some(decision.verdict(Self::NAME, items[at].row, &view.facts));
        }
        kept[earlier..].sort_by(|a, b| a.id.cmp(&b.id));
        // Every item is either undecodable or has been judged, so none is dropped here.
        Ok((write_state(&kept), verdicts.into_iter().flatten().collect()))
    }
}

/// One photo as the comparison sees it.
#[derive(Debug, Clone)]
struct ComparedPhoto {
    id: String,
    facts: PhotoFacts,
    sketch: ViewDescriptor,
}

/// Below this the colours of a photo are one tint: narrow-band JPEG copies have 0.0025 to 0.0095, the palest photo
/// of the Navcam feed 0.021, rover and fox 0.087 and more.
const COLOUR: f64 = 0.014;

impl ComparedPhoto {
    /// Orders the better photo first; ids are unique, so no two are equal.
    fn better(&self, other: &Self) -> Ordering {
        let area = |view: &Self| u64::from(view.sketch.width) * u64::from(view.sketch.height);
        other
            .is_broad()
            .cmp(&self.is_broad())
            .then_with(|| (other.sketch.colour >= COLOUR).cmp(&(self.sketch.colour >= COLOUR)))
            .then_with(|| processing_rank(&self.id).cmp(&processing_rank(&other.id)))
            .then_with(|| other.sketch.sharpness.total_cmp(&self.sketch.sharpness))
            .then_with(|| area(other).cmp(&area(self)))
            .then_with(|| self.id.cmp(&other.id))
    }

    /// Tells whether the archive names no colour filter, or a broad-band one: `0` of the science cameras, `F` (full
    /// colour), `E` (its mosaic) and `M` (panchromatic) of the engineering cameras of Mars 2020.
    fn is_broad(&self) -> bool {
        self.facts
            .filter
            .as_deref()
            .is_none_or(|filter| matches!(filter, "0" | "UNK" | "" | "F" | "E" | "M"))
    }
}

impl Duplicate {
    /// Compares with all that are kept; of several twins the most alike is named, of equals the first.
    fn judge(&self, view: &ComparedPhoto, kept: &[ComparedPhoto]) -> Decision {
        let mut nearest: Option<(f64, Decision)> = None;
        for other in kept
            .iter()
            .filter(|other| same_aspect(&view.sketch, &other.sketch))
        {
            let compared = match self.params.rule {
                DuplicateRule::Confirmed => self.confirm(view, other),
                DuplicateRule::Phash => Some(self.hashes_alone(view, other)),
            };
            if let Some((excess, decision)) = compared
                && nearest.as_ref().is_none_or(|(most, _)| excess > *most)
            {
                nearest = Some((excess, decision));
            }
        }
        nearest.map_or_else(|| Decision::pass(""), |(_, decision)| decision)
    }

    /// Returns by how much the pair is over its threshold, and the decision; `None` if it is no candidate.
    fn confirm(&self, view: &ComparedPhoto, other: &ComparedPhoto) -> Option<(f64, Decision)> {
        let bits = bits(&view.sketch, &other.sketch);
        let relation = relation_between((&view.id, &view.facts), (&other.id, &other.facts));
        if bits > self.params.candidate_bits && relation == Relation::Unknown {
            return None;
        }
        let limit = self.limit(relation);
        let score = correlation(&view.sketch, &other.sketch);
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

    fn limit(&self, relation: Relation) -> f64 {
        let (usual, filter) = (self.params.min_correlation, self.params.filter_correlation);
        let limit = match relation {
            Relation::SameExposure => self.params.version_correlation,
            Relation::SamePointing => filter,
            Relation::SameCamera => (usual + filter) / 2.0,
            Relation::Unknown => usual,
        };
        limit.min(usual)
    }

    fn hashes_alone(&self, view: &ComparedPhoto, other: &ComparedPhoto) -> (f64, Decision) {
        let (bits, limit) = (brightness_bits(&view.sketch, &other.sketch), self.params.max_bits);
        let (score, threshold) = (f64::from(bits), f64::from(limit));
        let reason = || format!("like `{}`: hashes {bits} bits apart, less than {limit}", other.id);
        (
            threshold - score,
            compared(bits < limit, score, threshold, reason, other),
        )
    }
}

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

/// Returns the photo, or its verdict if it could not be decoded.
fn read_item(item: &Measured<'_>) -> Result<Result<ComparedPhoto, Verdict>, StageError> {
    let facts = facts_of(item.row)?;
    match survey::part(item.measure, Duplicate::NAME, item.row)? {
        Ok(mut sketch) => {
            let sketch =
                ViewDescriptor::decode(&mut sketch).ok_or_else(|| unreadable(item.row, "it is no sketch"))?;
            let id = item.row.id.clone();
            Ok(Ok(ComparedPhoto { id, facts, sketch }))
        }
        Err(reason) => Ok(Err(undecodable(item.row, &facts, reason))),
    }
}

/// Writes, for each photo, a length and a JSON header (u32 LE first), then its sketch.
fn write_state(kept: &[ComparedPhoto]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for view in kept {
        let head = StateHeader {
            id: view.id.clone(),
            instrument: view.facts.instrument.clone(),
            filter: view.facts.filter.clone(),
            sol: view.facts.sol,
        };
        // Strings and numbers always serialise; an empty header would be refused on reading.
        let head = serde_json::to_vec(&head).unwrap_or_default();
        bytes.extend((head.len() as u32).to_le_bytes());
        bytes.extend(head);
        bytes.extend(view.sketch.encode());
    }
    bytes
}

/// What later sols need to know of a kept photo beside its sketch.
#[derive(Serialize, Deserialize)]
struct StateHeader {
    id: String,
    instrument: Option<String>,
    filter: Option<String>,
    sol: Option<u32>,
}

fn read_state(mut bytes: &[u8]) -> Result<Vec<ComparedPhoto>, StageError> {
    let mut kept = Vec::new();
    while !bytes.is_empty() {
        let view = read_view(&mut bytes);
        kept.push(view.ok_or_else(|| broken(format!("state cannot be read after {} photos", kept.len())))?);
    }
    Ok(kept)
}

fn read_view(bytes: &mut &[u8]) -> Option<ComparedPhoto> {
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
    let sketch = ViewDescriptor::decode(bytes)?;
    Some(ComparedPhoto {
        id: head.id,
        facts,
        sketch,
    })
}

fn broken(message: String) -> StageError {
    StageError::new(message).hint("the store may be damaged: measure again in an empty one, `--store DIR`")
}
