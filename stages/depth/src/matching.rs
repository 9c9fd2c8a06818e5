//! The photos of a scene, matched in pairs that are kept from run to run.

use marf_cache::Digest;
use marf_scene::Scene;
use marf_schema::depth::RowOffset;
use marf_stage::{Ctx, StageError};
use marf_surface::ExportFrame;
use nalgebra::Vector3;

use crate::disparities::match_pair;
use crate::faults::{PairFault, fault, hidden};
use crate::kept::{self, MatchedPair, Sample};
use crate::merge::{PairView, PhotoDepth, merge};
use crate::pairs::{Pair, Pairs, choose};
use crate::photos::Photos;
use crate::rectify::PosedCamera;
use crate::rows::row_offset;
use crate::sky;

/// Of kept pairs. Raised when the disparities of a pair may differ.
const PAIR_VERSION: u32 = 3;
/// Most surfaces of a pair whose pixels are measured.
const WIDTHS: usize = 1024;

/// The pairs of a scene's photos with what each found.
pub(crate) struct Matching<'a> {
    ctx: &'a Ctx<'a>,
    scene: &'a Scene,
    pub photos: Photos<'a>,
    pub views: Vec<PosedCamera>,
    /// Of scenes in metres: others may be rooms, whose plain walls are no sky.
    up: Option<Vector3<f64>>,
    pub pairs: Pairs,
    /// One for each chosen pair.
    pub outcomes: Vec<PairOutcome>,
}

impl<'a> Matching<'a> {
    /// Chooses pairs, at most `neighbours` a photo, and matches them in pictures of `side_px` at most.
    ///
    /// # Errors
    /// A photo that cannot be read, or the wish to stop.
    pub fn new(
        ctx: &'a Ctx<'a>,
        scene: &'a Scene,
        side_px: u32,
        neighbours: u32,
    ) -> Result<Self, StageError> {
        let mut photos = Photos::new(ctx, &scene.frames, side_px);
        let views = photos.views();
        let pairs = choose(scene, &views, neighbours as usize);
        let outcomes = match_all(ctx, scene, &mut photos, &pairs)?;
        let frame = ExportFrame::new(scene);
        Ok(Self {
            ctx,
            scene,
            photos,
            views,
            up: frame.metres_per_unit.and(frame.up),
            pairs,
            outcomes,
        })
    }

    /// Returns the pairs of a photo that found something.
    pub fn pairs_of(&self, photo: usize) -> impl Iterator<Item = &Pair> {
        let pairs = self.pairs.chosen.iter().zip(&self.outcomes);
        let found = pairs.filter(move |(pair, one)| pair.photos.contains(&photo) && one.reason.is_empty());
        found.map(|(pair, _)| pair)
    }

    /// Returns the depths of a photo, from all its pairs.
    ///
    /// # Errors
    /// As [`Matching::new`].
    pub fn depth_of(&mut self, photo: usize) -> Result<PhotoDepth, StageError> {
        self.ctx.check()?;
        let (at, total) = (photo as u64, self.scene.frames.len() as u64);
        let note = format!("depths of {}", self.scene.frames[photo].id);
        self.ctx.progress.at(at, total, &note);
        let found: Vec<Pair> = self.pairs_of(photo).cloned().collect();
        let views = found
            .iter()
            .map(|pair| view_of(self.ctx, self.scene, &mut self.photos, pair, photo));
        let views = views.collect::<Result<Vec<_>, _>>()?;
        let view = self.views[photo];
        let mut depth = merge(view.camera, &views);
        if let Some(up) = &self.up
            && !views.is_empty()
        {
            let picture = &self.photos.get(photo)?.picture;
            sky::mark(&mut depth, picture, &view.cam_from_world, up);
        }
        Ok(depth)
    }

    /// Returns why no pair of a photo found anything. Empty if one did.
    pub fn reason(&self, photo: usize) -> String {
        if self.pairs_of(photo).next().is_some() {
            return String::new();
        }
        let mut own = self.pairs.chosen.iter().zip(&self.outcomes);
        if let Some((_, outcome)) = own.find(|(pair, _)| pair.photos.contains(&photo)) {
            return outcome.reason.clone();
        }
        let mut refused = self.pairs.refused.iter();
        match refused.find(|refused| refused.photos.contains(&photo)) {
            Some(refused) => refused.why.to_string(),
            None => "no other photo shows the same".to_owned(),
        }
    }
}

/// How the matching of a pair went.
#[derive(Default)]
pub(crate) struct PairOutcome {
    pub share: f64,
    pub rows: Option<RowOffset>,
    /// Widths of pixels on some of the surfaces that it found, units of the world.
    pub widths: Vec<f64>,
    /// Why there are no disparities. Empty if there are.
    pub reason: String,
}

/// Matches all pairs, so that each is kept.
fn match_all(
    ctx: &Ctx<'_>,
    scene: &Scene,
    photos: &mut Photos<'_>,
    pairs: &Pairs,
) -> Result<Vec<PairOutcome>, StageError> {
    let total = pairs.chosen.len() as u64;
    let one = |(done, pair): (usize, &Pair)| {
        ctx.check()?;
        ctx.progress.at(done as u64, total, "pairs of photos");
        Ok(match samples(ctx, scene, photos, pair)? {
            Ok(MatchedPair { samples, rows }) => {
                let known: Vec<&Sample> = samples.values.iter().filter(|sample| sample.is_some()).collect();
                let rectified = &pair.rectified;
                let width = |sample: &&Sample| {
                    1.0 / (rectified.inverse_depth(f64::from(sample.disparity)) * rectified.focal_px)
                };
                let widths = known
                    .iter()
                    .step_by(known.len().div_ceil(WIDTHS).max(1))
                    .map(width);
                PairOutcome {
                    share: known.len() as f64 / samples.values.len() as f64,
                    rows: (rows.matches > 0).then_some(rows),
                    widths: widths.filter(|width| *width > 0.0).collect(),
                    reason: String::new(),
                }
            }
            Err(fault) => PairOutcome {
                reason: fault.to_string(),
                ..PairOutcome::default()
            },
        })
    };
    pairs.chosen.iter().enumerate().map(one).collect()
}

/// Returns what a pair says about one of its photos.
fn view_of(
    ctx: &Ctx<'_>,
    scene: &Scene,
    photos: &mut Photos<'_>,
    pair: &Pair,
    photo: usize,
) -> Result<PairView, StageError> {
    let MatchedPair { samples, rows } =
        samples(ctx, scene, photos, pair)?.map_err(|fault| StageError::new(fault.to_string()))?;
    let is_left = pair.photos[0] == photo;
    Ok(PairView {
        samples: if is_left {
            samples
        } else {
            kept::seen_from_right(&samples)
        },
        rectified: pair.rectified,
        eye: if is_left {
            pair.rectified.left
        } else {
            pair.rectified.right.with_rows(rows)
        },
    })
}

/// Returns the disparities of a pair, kept or matched now, or the reason why there are none.
fn samples(
    ctx: &Ctx<'_>,
    scene: &Scene,
    photos: &mut Photos<'_>,
    pair: &Pair,
) -> Result<Result<MatchedPair, PairFault>, StageError> {
    let key = key(scene, pair);
    let camera = &pair.rectified.left.camera;
    let size = [camera.width as usize, camera.height as usize];
    let read = |bytes: &[u8]| kept::decode(bytes, size, pair.search);
    let judged = |matched: MatchedPair| match fault(&matched, pair.rectified.focal_px) {
        Some(fault) => Err(fault),
        None => Ok(matched),
    };
    if let Some(matched) = ctx.memos.load(&key).and_then(|bytes| read(&bytes)) {
        return Ok(judged(matched));
    }
    let [left_photo, right_photo] = [photos.get(pair.photos[0])?, photos.get(pair.photos[1])?];
    let (left, right_by_cameras) = rayon::join(
        || pair.rectified.left.resample(&left_photo.picture),
        || pair.rectified.right.resample(&right_photo.picture),
    );
    if let Some(fault) = hidden(&left, &right_by_cameras) {
        return Ok(Err(fault));
    }
    let rows = row_offset(&left, &right_by_cameras, pair.search);
    let moved = |rows| {
        pair.rectified
            .right
            .with_rows(rows)
            .resample(&right_photo.picture)
    };
    let right = rows.map_or(right_by_cameras, moved);
    let found = match match_pair(&left, &right, pair.search) {
        Ok(found) => found,
        Err(error) => return Ok(Err(error.into())),
    };
    let bytes = kept::encode(&found, &rows.unwrap_or_default(), pair.search);
    ctx.memos.save(&key, &bytes);
    let matched = read(&bytes).ok_or_else(|| StageError::new("disparities that cannot be kept"))?;
    Ok(judged(matched))
}

/// Returns the digest of everything that the disparities of a pair depend on.
fn key(scene: &Scene, pair: &Pair) -> Digest {
    let of = pair.photos.map(|photo| {
        let frame = &scene.frames[photo];
        format!("{} {:?}", frame.image, frame.mask)
    });
    let text = format!(
        "depth pair {PAIR_VERSION} {of:?} {:?} {:?}",
        pair.rectified, pair.search
    );
    Digest::from_content(text.as_bytes())
}
