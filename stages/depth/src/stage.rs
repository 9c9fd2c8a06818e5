//! The stage `depth`: pairs of photos to depths, a cloud and maps.

use std::collections::BTreeMap;

use marf_cache::Digest;
use marf_numeric::{quantile, upper_median};
use marf_scene::{Scene, picture_names};
use marf_schema::depth::{DepthParams, Metrics, PairMetrics, PhotoMetrics, RowOffset};
use marf_schema::output::{
    DEPTH, DEPTH_CLASS, DEPTH_PREVIEW, INVERSE_DEPTH, POINTS, SCENE, SIGMA, SURFACE_MAPS,
};
use marf_stage::{Ctx, Document, Inputs, Outputs, Port, Set, StageError, Threads, TypedOutputs, stage};
use marf_surface::{ExportFrame, SurfaceError};

use crate::cloud::{self, Cloud};
use crate::disparities::match_pair;
use crate::faults::{PairFault, fault, hidden};
use crate::ground::Ground;
use crate::kept::{self, MatchedPair, Sample};
use crate::merge::{PairView, PhotoDepth, merge};
use crate::pairs::{Pair, Pairs, choose};
use crate::photos::Photos;
use crate::rectify::PosedCamera;
use crate::rows::row_offset;
use crate::surfels::surfels;
use crate::write;

/// Of kept pairs. Raised when the disparities of a pair may differ.
const PAIR_VERSION: u32 = 2;
/// Cells of the cloud are this many pixels wide where the nearer quarter of the found surfaces ends.
const CELL_PX: f64 = 2.0;
const NEARER: f64 = 0.25;
/// Most surfaces of a pair whose pixels are measured.
const WIDTHS: usize = 1024;
/// Surfaces whose pixels are wider than this many cells are in the depths of the photos alone.
const COARSEST: f64 = 4.0;

/// Makes depths of the photos of a scene, without a field.
#[derive(Debug)]
pub struct MakeDepth {
    params: DepthParams,
}

stage! {
    MakeDepth { params: DepthParams },
    Set,
    Threads::All,
    about: "makes depths, points, a height map and an orthophoto from pairs of photos, without a field",
    version: 2,
    ports: [Port::required("input", SCENE)],
    outputs: [
        Metrics::OUTPUT,
        DEPTH,
        DEPTH_PREVIEW,
        INVERSE_DEPTH,
        SIGMA,
        DEPTH_CLASS,
        POINTS,
        SURFACE_MAPS,
    ],
}

impl Set for MakeDepth {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let scene = Scene::decode(&ctx.get(inputs.required(SCENE)?)?);
        let scene = scene.map_err(|error| StageError::new(error.to_string()))?;
        let mut photos = Photos::new(ctx, &scene.frames, self.params.side_px);
        let views = photos.views();
        let pairs = choose(&scene, &views, self.params.neighbours as usize);
        let names = picture_names(&scene);
        let matched = match_all(ctx, &scene, &mut photos, &pairs)?;
        let widths = matched.iter().flat_map(|one| one.widths.iter().copied());
        // Without any, there is no point either.
        let width = quantile(widths, NEARER).unwrap_or(1.0);
        let mut made = Products::new(&scene, CELL_PX * width, &self.params);
        let mut outputs = Outputs::new();
        let total = scene.frames.len();
        for (index, name) in names.iter().enumerate() {
            ctx.check()?;
            ctx.progress
                .at(index as u64, total as u64, &format!("depths of {name}"));
            let mut of_photo = Vec::new();
            for (pair, matched) in pairs.chosen.iter().zip(&matched) {
                if pair.photos.contains(&index) && matched.reason.is_empty() {
                    of_photo.push(view_of(ctx, &scene, &mut photos, pair, index)?);
                }
            }
            let depth = merge(views[index].camera, &of_photo);
            let reason = if of_photo.is_empty() {
                reason(&pairs, &matched, index)
            } else {
                String::new()
            };
            let metrics = write::photo(ctx, name, &depth, &made.frame, &mut outputs)?;
            made.photos.push(PhotoMetrics {
                id: scene.frames[index].id.clone(),
                pairs: of_photo.len() as u32,
                reason,
                ..metrics
            });
            made.add(&views[index], &depth, &mut photos, index)?;
        }
        let pairs_metrics = pairs
            .chosen
            .iter()
            .zip(&matched)
            .map(|(pair, matched)| PairMetrics {
                photos: pair.photos.map(|photo| names[photo].clone()),
                angle_deg: pair.angle_deg,
                overlap: pair.overlap,
                baseline: pair.rectified.baseline * made.frame.scale(),
                disparities: pair.search.count as u32,
                share: matched.share,
                rows: matched.rows,
                reason: matched.reason.clone(),
            });
        let pairs_metrics: Vec<PairMetrics> = pairs_metrics.collect();
        made.finish(ctx, &pairs, pairs_metrics, &mut outputs)?;
        Ok(outputs)
    }
}

/// How the matching of a pair went.
#[derive(Default)]
struct PairOutcome {
    share: f64,
    rows: Option<RowOffset>,
    /// Widths of pixels on some of the surfaces that it found, units of the world.
    widths: Vec<f64>,
    /// Why there are no disparities. Empty if there are.
    reason: String,
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

/// Returns why a photo is in no pair that could be matched.
fn reason(pairs: &Pairs, matched: &[PairOutcome], photo: usize) -> String {
    let mut own = pairs
        .chosen
        .iter()
        .zip(matched)
        .filter(|(pair, _)| pair.photos.contains(&photo));
    if let Some((_, outcome)) = own.next() {
        return outcome.reason.clone();
    }
    let refused = pairs
        .refused
        .iter()
        .filter(|refused| refused.photos.contains(&photo));
    match refused.map(|refused| refused.why).next() {
        Some(why) => why.to_string(),
        None => "no other photo shows the same".to_owned(),
    }
}

/// What all photos give together.
struct Products {
    frame: ExportFrame,
    photos: Vec<PhotoMetrics>,
    cloud: Cloud,
    ground: Result<Ground, SurfaceError>,
    /// Distance from a camera beyond which its pixels are too wide, times the angle of a pixel.
    widest: f64,
}

impl Products {
    /// `cell`: the width of a cell of the cloud, units of the world.
    fn new(scene: &Scene, cell: f64, params: &DepthParams) -> Self {
        let frame = ExportFrame::new(scene);
        let ground = Ground::new(&frame, params.map_cell, cell);
        let pixel = ground
            .as_ref()
            .map_or(cell, |ground| ground.pixel_m / frame.scale());
        Self {
            frame,
            photos: Vec::new(),
            cloud: Cloud::new(cell),
            ground,
            widest: COARSEST * cell.max(pixel),
        }
    }

    /// Adds the depths of a photo to cloud and map.
    fn add(
        &mut self,
        view: &PosedCamera,
        depth: &PhotoDepth,
        photos: &mut Photos<'_>,
        index: usize,
    ) -> Result<(), StageError> {
        if depth.inverse.iter().all(|inverse| *inverse == 0.0) {
            return Ok(());
        }
        let photo = photos.get(index)?;
        let reach = self.widest * view.camera.fx_px.min(view.camera.fy_px);
        let surfels = surfels(depth, &view.cam_from_world, &photo, self.frame.up, reach);
        let points: Vec<_> = surfels.iter().flatten().copied().collect();
        self.cloud.add(&points);
        if let Ok(ground) = &mut self.ground
            && let Err(refused) = ground.add(&surfels, view.camera.width as usize)
        {
            self.ground = Err(refused);
        }
        Ok(())
    }

    /// Writes cloud, maps and metrics.
    fn finish(
        self,
        ctx: &Ctx<'_>,
        pairs: &Pairs,
        matched: Vec<PairMetrics>,
        outputs: &mut Outputs,
    ) -> Result<(), StageError> {
        let scale = self.frame.scale();
        let cell = self.cloud.cell;
        let points = self.cloud.points();
        outputs.put_bytes(ctx, POINTS, &cloud::ply(&points, &self.frame, cell))?;
        let mut missing = BTreeMap::new();
        let map = match self.ground.and_then(|ground| ground.map(&self.frame)) {
            Ok(map) => {
                write::maps(ctx, &map, outputs)?;
                Some(map.report)
            }
            // Depths and points are useful without a map, and the metrics hold the reason why there is none.
            Err(why) => {
                missing.insert(SURFACE_MAPS.to_owned(), why.to_string());
                None
            }
        };
        let mut refused: BTreeMap<String, u64> = BTreeMap::new();
        for one in &pairs.refused {
            *refused.entry(one.why.to_string()).or_default() += 1;
        }
        let pixels: f64 = self.photos.iter().map(pixels_of).sum();
        let share = |of: &dyn Fn(&PhotoMetrics) -> f64| {
            self.photos
                .iter()
                .map(|photo| of(photo) * pixels_of(photo))
                .sum::<f64>()
                / pixels.max(1.0)
        };
        let metrics = Metrics {
            unit: self.frame.unit().to_owned(),
            share: share(&|photo| photo.share),
            confirmed_share: share(&|photo| photo.confirmed_share),
            median_sigma_share: upper_median(self.photos.iter().filter_map(|photo| photo.median_sigma_share)),
            pairs: matched,
            refused,
            points: points.len() as u64,
            cell: cell * scale,
            map,
            missing,
            photos: self.photos,
        };
        outputs.put(ctx, &metrics)
    }
}

fn pixels_of(photo: &PhotoMetrics) -> f64 {
    f64::from(photo.size_px[0]) * f64::from(photo.size_px[1])
}
