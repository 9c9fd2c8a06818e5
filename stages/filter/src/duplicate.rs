//! The filter `duplicate`.

use std::cmp::Ordering;
use std::sync::Arc;

use marf_cache::{Digest, manifest::Row};
use marf_stage::{
    Ctx, Define, Fold, FoldState, Measure, Measured, ParamError, Port, Stage, StageError, Table, Verdict,
    Work,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::by_hand::ByHand;
use crate::candidates::{Candidates, PhotoKeys};
use crate::decision::Decision;
use crate::descriptor::ViewDescriptor;
use crate::filter::{Facts, check_range, undecodable};
#[cfg(test)]
use crate::guard::Guard;
use crate::index::Search;
use crate::kept::{Added, GroupPhotos, KeptPhoto, Reader};
use crate::relation::{Relation, Relative, processing_rank, relation_between};
use crate::similarity::{Planes, correlation, hash_distance, same_aspect};
use crate::stage::{OUTPUTS, PORTS};
use crate::survey::{Section, Surveyed, measure_row, measured, tables, unreadable};

/// Rejects photos that show the same view as a better one, whatever their size, light and colour filter.
///
/// The better photo is, in this order: kept by hand, broad-band, in colour, calibrated radiance of several versions of
/// an exposure, sharper, larger, of the smaller id. A photo is rejected only if it is similar to one that is kept, so of
/// a chain of neighbours some are always kept; a photo of an earlier sol is preferred to one of a later sol.
pub struct Duplicate {
    params: DuplicateParams,
}

/// The rule of [`Duplicate`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DuplicateRule {
    /// Perceptual hash for candidates, correlation of gradients as proof: stereo partners and video neighbours
    /// are kept.
    Confirmed,
    /// The paper's rule: perceptual hashes of brightness closer than `max_bits`.
    Phash,
}

/// Parameters of [`Duplicate`].
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
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
        table: Self::TABLE,
        measure: |ctx, photo| {
            let (descriptor, planes) = ViewDescriptor::of(photo);
            ctx.put(&planes)?;
            Ok(descriptor.encode())
        },
    });
    #[cfg(test)]
    const GUARD: Guard = Guard {
        measures: "3 9b0277c7e112",
        decisions: "3 8a7685578a5e",
    };
}

impl Measure for Duplicate {
    fn table(&self) -> Option<Table> {
        Some(Self::TABLE)
    }

    fn together(&self) -> Vec<Table> {
        tables()
    }

    fn measure(&self, ctx: &Ctx<'_>, row: &Row, wanted: &[Table]) -> Result<Vec<Vec<u8>>, StageError> {
        measure_row(ctx, row, wanted)
    }

    /// Returns the gradient planes that a [`ViewDescriptor`] names.
    fn blobs(&self, measure: &[u8]) -> Vec<Digest> {
        let descriptor = measure.get(1..).and_then(ViewDescriptor::decode);
        descriptor
            .map(|descriptor| descriptor.planes)
            .into_iter()
            .collect()
    }
}

impl Fold for Duplicate {
    fn begin(&self) -> Box<dyn FoldState + '_> {
        Box::new(KeptPhotos {
            duplicate: self,
            candidates: Candidates::new(self.search()),
            groups: Vec::new(),
            reader: Reader::new(),
        })
    }
}

/// The photos kept so far: of each what it is found by; what it is compared by is read when it is a candidate.
struct KeptPhotos<'a> {
    duplicate: &'a Duplicate,
    candidates: Candidates,
    /// The position of the first photo of each group, and the blob with its photos.
    groups: Vec<(u32, Digest)>,
    reader: Reader,
}

impl FoldState for KeptPhotos<'_> {
    fn replay(&mut self, _: &Ctx<'_>, added: &[u8]) -> Result<(), StageError> {
        for group in Added::read(added)? {
            self.groups.push((self.candidates.len(), group.photos));
            group
                .keys
                .iter()
                .for_each(|(keys, _)| self.candidates.insert(keys));
        }
        Ok(())
    }

    /// Decides on the photos of one sol, the best first; each is compared with those kept of earlier sols and of its own.
    fn fold(&mut self, ctx: &Ctx<'_>, items: &[Measured<'_>]) -> Result<(Vec<u8>, Vec<Verdict>), StageError> {
        let duplicate = self.duplicate;
        let read = |item| duplicate.read_photo(item);
        let read = items.iter().map(read).collect::<Result<Vec<_>, _>>()?;
        let mut best_first: Vec<(usize, &ComparedPhoto<'_>)> = read
            .iter()
            .enumerate()
            .filter_map(|(at, item)| item.as_ref().ok().map(|photo| (at, photo)))
            .collect();
        best_first.sort_by(|a, b| a.1.compare_quality(b.1));
        let mut verdicts: Vec<Option<Verdict>> =
            read.iter().map(|item| item.as_ref().err().cloned()).collect();
        let mut own = OwnSol {
            candidates: Candidates::new(duplicate.search()),
            photos: Vec::new(),
        };
        let mut earlier = Vec::new();
        for (number, (at, photo)) in best_first.iter().copied().enumerate() {
            ctx.check()?;
            if number % BATCH == 0 {
                earlier = self.find_earlier(&best_first[number..(number + BATCH).min(best_first.len())]);
            }
            let candidates = earlier.get_mut(number % BATCH).map(std::mem::take);
            let decision = self.decide(ctx, photo, candidates, &own)?;
            let decision = duplicate
                .params
                .by_hand
                .overrule(photo.id(), photo.facts.file, decision);
            if decision.keep {
                own.candidates.insert(&photo.keys);
                own.photos.push(photo);
            }
            verdicts[at] = Some(decision.verdict(Duplicate::NAME, items[at].row, &photo.facts));
        }
        own.photos.sort_by_key(|photo| photo.id());
        let kept: Vec<_> = own
            .photos
            .iter()
            .map(|photo| (photo.kept(), photo.keys.clone()))
            .collect();
        let added = Added::write(ctx, &kept)?;
        self.replay(ctx, &added)?;
        // Every photo either has the verdict of the decoder or has been decided on, so `flatten` drops none.
        Ok((added, verdicts.into_iter().flatten().collect()))
    }

    fn blobs(&self, added: &[u8]) -> Vec<Digest> {
        // Bytes that cannot be read are refused by `replay`.
        let groups = Added::read(added).unwrap_or_default();
        let named =
            |group: Added| std::iter::once(group.photos).chain(group.keys.into_iter().map(|keys| keys.1));
        groups.into_iter().flat_map(named).collect()
    }
}

/// Photos whose candidates of earlier sols are looked for together.
const BATCH: usize = 1024;

/// The photos kept of the sol that is decided on, in the order in which they were kept.
struct OwnSol<'a> {
    candidates: Candidates,
    photos: Vec<&'a ComparedPhoto<'a>>,
}

impl KeptPhotos<'_> {
    /// Returns the candidates of earlier sols of each of some photos; nothing where they are to be found one by one.
    fn find_earlier(&self, photos: &[(usize, &ComparedPhoto<'_>)]) -> Vec<Vec<u32>> {
        if self.duplicate.params.rule == DuplicateRule::Phash {
            return Vec::new();
        }
        let keys: Vec<&PhotoKeys> = photos.iter().map(|(_, photo)| &photo.keys).collect();
        self.candidates.find_many(&keys).unwrap_or_default()
    }

    /// Decides on a photo by comparing it with those kept that may show its view; the reason names the most similar one, of
    /// equals the first. `earlier` are its candidates of earlier sols, where they are known.
    fn decide(
        &mut self,
        ctx: &Ctx<'_>,
        photo: &ComparedPhoto<'_>,
        earlier: Option<Vec<u32>>,
        own: &OwnSol<'_>,
    ) -> Result<Decision, StageError> {
        match self.duplicate.params.rule {
            DuplicateRule::Confirmed => {
                let earlier = earlier.unwrap_or_else(|| self.candidates.find(&photo.keys));
                self.decide_confirmed(ctx, photo, &earlier, own)
            }
            DuplicateRule::Phash => self.decide_phash(ctx, photo, own),
        }
    }

    /// Decides by the rule [`DuplicateRule::Confirmed`].
    fn decide_confirmed(
        &mut self,
        ctx: &Ctx<'_>,
        photo: &ComparedPhoto<'_>,
        earlier: &[u32],
        own: &OwnSol<'_>,
    ) -> Result<Decision, StageError> {
        let mut nearest = Nearest {
            duplicate: self.duplicate,
            photo,
            planes: None,
            found: None,
        };
        for position in earlier {
            let (group, at) = self.earlier(ctx, *position)?;
            nearest.compare(ctx, &mut self.reader, &group.photo(at)?, None)?;
        }
        for position in own.candidates.find(&photo.keys) {
            if let Some(other) = own.photos.get(position as usize) {
                nearest.compare(ctx, &mut self.reader, &other.kept(), Some(other.row))?;
            }
        }
        let found = nearest.found.map(|(_, decision)| decision);
        Ok(found.unwrap_or_else(|| Decision::pass("")))
    }

    /// Decides by the rule [`DuplicateRule::Phash`].
    fn decide_phash(
        &mut self,
        ctx: &Ctx<'_>,
        photo: &ComparedPhoto<'_>,
        own: &OwnSol<'_>,
    ) -> Result<Decision, StageError> {
        let (duplicate, size) = (self.duplicate, photo.keys.size);
        let mut nearest: Option<(u32, String)> = None;
        let candidates = std::mem::replace(&mut self.candidates, Candidates::new(Search::Nearest));
        let searched = candidates.find_nearest(&photo.keys, |bits, position| {
            let (group, at) = self.earlier(ctx, position)?;
            let other = group.photo(at)?;
            if same_aspect(size, other.size) {
                nearest = Some((bits, other.id.to_owned()));
            }
            Ok::<_, StageError>(nearest.is_some())
        });
        self.candidates = candidates;
        searched?;
        own.candidates.find_nearest(&photo.keys, |bits, position| {
            let other = own.photos.get(position as usize);
            let nearer = nearest.as_ref().is_none_or(|(least, _)| bits < *least);
            let same = other.filter(|other| nearer && same_aspect(size, other.keys.size));
            if let Some(other) = same {
                nearest = Some((bits, other.id().to_owned()));
            }
            Ok::<_, StageError>(same.is_some() || !nearer)
        })?;
        let decision = nearest.map(|(bits, id)| duplicate.compare_hashes(bits, &id));
        Ok(decision.unwrap_or_else(|| Decision::pass("")))
    }

    /// Returns the group of a position among the photos of earlier sols, and the place in it.
    fn earlier(&mut self, ctx: &Ctx<'_>, position: u32) -> Result<(Arc<GroupPhotos>, usize), StageError> {
        let after = self.groups.partition_point(|(first, _)| *first <= position);
        let lost = || StageError::new(format!("no group holds photo {position}"));
        let (first, digest) = self.groups[..after].last().ok_or_else(lost)?;
        Ok((self.reader.group(ctx, digest)?, (position - first) as usize))
    }
}

/// The comparison of a photo with its candidates.
struct Nearest<'a> {
    duplicate: &'a Duplicate,
    photo: &'a ComparedPhoto<'a>,
    /// The planes of the photo, once a candidate needs them.
    planes: Option<Arc<Planes>>,
    /// By how much the score of the most similar one so far exceeds its threshold, and the decision.
    found: Option<(f64, Decision)>,
}

impl Nearest<'_> {
    /// Compares with one candidate by hashes and gradients; those whose hashes are too far apart do not count, unless they
    /// are related.
    fn compare(
        &mut self,
        ctx: &Ctx<'_>,
        reader: &mut Reader,
        other: &KeptPhoto<'_>,
        row: Option<&Row>,
    ) -> Result<(), StageError> {
        if !same_aspect(self.photo.keys.size, other.size) {
            return Ok(());
        }
        let params = &self.duplicate.params;
        let bits = hash_distance(&self.photo.keys.hashes, &other.hashes);
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
            None => self.planes.insert(reader.planes(ctx, &self.photo.planes)?),
        };
        let score = correlation(own, &*reader.planes(ctx, &other.planes)?);
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

/// A photo of the sol that is decided on.
#[derive(Debug)]
struct ComparedPhoto<'a> {
    row: &'a Row,
    facts: Facts<'a>,
    keys: PhotoKeys,
    /// Digest of the gradient planes.
    planes: Digest,
    sharpness: f64,
    colour: f64,
    kept_by_hand: bool,
    processing_rank: u8,
}

/// A photo whose [`ViewDescriptor::colour`] is below this has one tint: narrow-band JPEG copies have 0.0025 to 0.0095,
/// the palest photo of the Navcam feed 0.021, rover and fox 0.087 and more.
const MIN_COLOUR: f64 = 0.014;

impl<'a> ComparedPhoto<'a> {
    fn id(&self) -> &'a str {
        &self.row.id
    }

    fn relative(&self) -> Relative<'a> {
        Relative::of(self.row, &self.facts)
    }

    /// Returns what photos of this sol and of later ones compare it by.
    fn kept(&self) -> KeptPhoto<'a> {
        KeptPhoto {
            id: self.id(),
            instrument: self.facts.instrument,
            filter: self.facts.filter,
            sol: self.facts.sol,
            size: self.keys.size,
            hashes: self.keys.hashes.clone(),
            planes: self.planes,
        }
    }

    /// Orders the better photo first; ids are unique, so no two photos are equal.
    fn compare_quality(&self, other: &Self) -> Ordering {
        let area = |photo: &Self| u64::from(photo.keys.size.width) * u64::from(photo.keys.size.height);
        (other.kept_by_hand.cmp(&self.kept_by_hand))
            .then_with(|| other.is_broad().cmp(&self.is_broad()))
            .then_with(|| (other.colour >= MIN_COLOUR).cmp(&(self.colour >= MIN_COLOUR)))
            .then_with(|| self.processing_rank.cmp(&other.processing_rank))
            .then_with(|| other.sharpness.total_cmp(&self.sharpness))
            .then_with(|| area(other).cmp(&area(self)))
            .then_with(|| self.id().cmp(other.id()))
    }

    /// Returns whether the archive names no colour filter, or a broad-band one: `0` of the science cameras, `F` (full
    /// colour), `E` (its mosaic) and `M` (panchromatic) of the engineering cameras of Mars 2020.
    fn is_broad(&self) -> bool {
        self.facts
            .filter
            .is_none_or(|filter| matches!(filter, "0" | "UNK" | "" | "F" | "E" | "M"))
    }
}

impl Duplicate {
    /// As [`Filter::MEASURE_VERSION`](crate::Filter::MEASURE_VERSION).
    const MEASURE_VERSION: u32 = 3;
    /// As [`Filter::DECISION_VERSION`](crate::Filter::DECISION_VERSION).
    const DECISION_VERSION: u32 = 0;

    /// Where its measures are kept.
    const TABLE: Table = Table {
        name: Self::NAME,
        version: Self::MEASURE_VERSION,
    };

    /// Returns what the rule asks of the hashes.
    fn search(&self) -> Search {
        match self.params.rule {
            DuplicateRule::Confirmed => Search::Within(self.params.candidate_bits),
            DuplicateRule::Phash => Search::Nearest,
        }
    }

    /// Reads a photo with its descriptor; the inner error is the verdict of a photo that could not be decoded.
    fn read_photo<'a>(&self, item: &Measured<'a>) -> Result<Result<ComparedPhoto<'a>, Verdict>, StageError> {
        let facts = Facts::of(item.row)?;
        let descriptor = match measured(item.measure, item.row)? {
            Ok(descriptor) => ViewDescriptor::decode(descriptor),
            Err(reason) => return Ok(Err(undecodable(item.row, &facts, reason))),
        };
        let descriptor = descriptor.ok_or_else(|| unreadable(item.row, "it is no descriptor"))?;
        Ok(Ok(ComparedPhoto {
            row: item.row,
            keys: PhotoKeys {
                size: descriptor.size,
                hashes: descriptor.hashes,
                relation: Relative::of(item.row, &facts).keys(),
            },
            planes: descriptor.planes,
            sharpness: descriptor.sharpness,
            colour: descriptor.colour,
            kept_by_hand: self.params.by_hand.keeps(&item.row.id, facts.file),
            processing_rank: processing_rank(&item.row.id),
            facts,
        }))
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

    /// Decides by the distance of the hashes of brightness alone.
    fn compare_hashes(&self, bits: u32, other: &str) -> Decision {
        let limit = self.params.max_bits;
        let (score, threshold) = (f64::from(bits), f64::from(limit));
        let reason = || format!("like `{other}`: hashes {bits} bits apart, less than {limit}");
        compared(bits < limit, score, threshold, reason, other)
    }
}

/// Returns the decision on a photo that was compared with `other`.
fn compared(alike: bool, score: f64, limit: f64, reason: impl Fn() -> String, other: &str) -> Decision {
    if !alike {
        return Decision {
            reason: format!("nearest is `{other}`"),
            ..Decision::keep(score, limit)
        };
    }
    Decision {
        twin: Some(other.to_owned()),
        ..Decision::reject(score, limit, reason())
    }
}
