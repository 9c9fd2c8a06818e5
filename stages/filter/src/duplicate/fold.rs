//! The fold of `duplicate`: sol by sol, the best photos of each view are kept.

use marf_cache::Digest;
use marf_stage::{Ctx, Define, FoldState, Measured, StageError, Verdict};

use super::nearest::Nearest;
use super::photo::ComparedPhoto;
use super::rule::{Duplicate, DuplicateRule};
use crate::bytes::to_bytes;
use crate::candidates::Candidates;
use crate::decision::Decision;
use crate::kept::{KeptPhotos, PlanesReader, read_added};
use crate::similarity::same_aspect;

/// The photos kept so far, and the search for those that may show the view of another.
pub(super) struct DuplicateState<'a> {
    duplicate: &'a Duplicate,
    candidates: Candidates,
    photos: KeptPhotos,
    reader: PlanesReader,
}

impl FoldState for DuplicateState<'_> {
    fn replay(&mut self, _: &Ctx<'_>, added: &[u8]) -> Result<(), StageError> {
        for photo in read_added(added)? {
            self.candidates.insert(&photo.keys);
            self.photos.insert(&photo)?;
        }
        Ok(())
    }

    /// Decides on the photos of one sol, the best first. Each is compared with kept photos of earlier sols and of its
    /// own.
    fn fold(&mut self, ctx: &Ctx<'_>, items: &[Measured<'_>]) -> Result<(Vec<u8>, Vec<Verdict>), StageError> {
        let duplicate = self.duplicate;
        let read = |item| ComparedPhoto::read(item, &duplicate.params.by_hand);
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
        for (at, photo) in best_first {
            ctx.check()?;
            let decision = match duplicate.params.rule {
                DuplicateRule::Confirmed => self.decide_confirmed(ctx, photo, &own)?,
                DuplicateRule::Phash => self.decide_phash(photo, &own)?,
            };
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
        let kept: Vec<_> = own.photos.iter().map(|photo| photo.kept()).collect();
        let added = to_bytes(&kept)?;
        self.replay(ctx, &added)?;
        // Every photo either has the verdict of the decoder or has been decided on, so `flatten` drops none.
        Ok((added, verdicts.into_iter().flatten().collect()))
    }

    fn blobs(&self, added: &[u8]) -> Vec<Digest> {
        // Bytes that cannot be read are refused by `replay`.
        let photos = read_added(added).unwrap_or_default();
        photos.iter().map(|photo| photo.planes).collect()
    }
}

/// The photos kept of the sol that is decided on, in the order in which they were kept.
struct OwnSol<'a> {
    candidates: Candidates,
    photos: Vec<&'a ComparedPhoto<'a>>,
}

impl<'a> DuplicateState<'a> {
    /// Returns no photos.
    pub(super) fn new(duplicate: &'a Duplicate) -> Self {
        Self {
            duplicate,
            candidates: Candidates::new(duplicate.search()),
            photos: KeptPhotos::default(),
            reader: PlanesReader::new(),
        }
    }

    /// Decides by the rule [`DuplicateRule::Confirmed`]: compares a photo with kept ones that may show its view. The reason names the
    /// most similar one, the first on ties.
    fn decide_confirmed(
        &mut self,
        ctx: &Ctx<'_>,
        photo: &ComparedPhoto<'_>,
        own: &OwnSol<'_>,
    ) -> Result<Decision, StageError> {
        let mut nearest = Nearest::new(self.duplicate, photo);
        for position in self.candidates.find(&photo.keys) {
            nearest.compare(ctx, &mut self.reader, &self.photos.photo(position)?, None)?;
        }
        for position in own.candidates.find(&photo.keys) {
            if let Some(other) = own.photos.get(position as usize) {
                nearest.compare(ctx, &mut self.reader, &other.kept(), Some(other.row))?;
            }
        }
        Ok(nearest.decision())
    }

    /// Decides by the rule [`DuplicateRule::Phash`].
    fn decide_phash(&self, photo: &ComparedPhoto<'_>, own: &OwnSol<'_>) -> Result<Decision, StageError> {
        let (duplicate, size) = (self.duplicate, photo.keys.size);
        let mut nearest: Option<(u32, String)> = None;
        self.candidates.find_nearest(&photo.keys, |bits, position| {
            let other = self.photos.photo(position)?;
            if same_aspect(size, other.keys.size) {
                nearest = Some((bits, other.id.to_owned()));
            }
            Ok::<_, StageError>(nearest.is_some())
        })?;
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
}
