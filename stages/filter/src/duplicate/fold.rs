//! The fold of `duplicate`: sol by sol, the best photos of each view are kept.

use std::sync::Arc;

use marf_cache::Digest;
use marf_stage::{Ctx, Define, FoldState, Measured, StageError, Verdict};

use super::nearest::Nearest;
use super::photo::ComparedPhoto;
use super::rule::{Duplicate, DuplicateRule};
use crate::candidates::{Candidates, Search};
use crate::decision::Decision;
use crate::kept::{Added, GroupPhotos, Reader};
use crate::similarity::same_aspect;

/// Search keys of the photos kept so far. The data to compare a photo by is read when it is a candidate.
pub(super) struct KeptPhotos<'a> {
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
                DuplicateRule::Phash => self.decide_phash(ctx, photo, &own)?,
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

/// The photos kept of the sol that is decided on, in the order in which they were kept.
struct OwnSol<'a> {
    candidates: Candidates,
    photos: Vec<&'a ComparedPhoto<'a>>,
}

impl<'a> KeptPhotos<'a> {
    /// Returns no photos.
    pub(super) fn new(duplicate: &'a Duplicate) -> Self {
        Self {
            duplicate,
            candidates: Candidates::new(duplicate.search()),
            groups: Vec::new(),
            reader: Reader::new(),
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
            let (group, at) = self.earlier(ctx, position)?;
            nearest.compare(ctx, &mut self.reader, &group.photo(at)?, None)?;
        }
        for position in own.candidates.find(&photo.keys) {
            if let Some(other) = own.photos.get(position as usize) {
                nearest.compare(ctx, &mut self.reader, &other.kept(), Some(other.row))?;
            }
        }
        Ok(nearest.decision())
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
