//! The stage `depth`: pairs of photos to depths, a cloud and maps.

use std::collections::BTreeMap;

use marf_numeric::{quantile, upper_median};
use marf_scene::{Scene, picture_names};
use marf_schema::depth::{DepthParams, Metrics, PairMetrics, PhotoMetrics};
use marf_schema::output::{
    DEPTH, DEPTH_CLASS, DEPTH_PREVIEW, INVERSE_DEPTH, NORMAL, POINTS, SCENE, SIGMA, SURFACE_MAPS,
};
use marf_stage::{Ctx, Document, Inputs, Outputs, Port, Set, StageError, Threads, TypedOutputs, stage};
use marf_surface::{ExportFrame, SurfaceError};

use crate::cloud::{self, Cloud};
use crate::ground::Ground;
use crate::matching::Matching;
use crate::merge::PhotoDepth;
use crate::pairs::Pairs;
use crate::surfels::surfels;
use crate::write;

/// Cells of the cloud are this many pixels wide where the nearer quarter of the found surfaces ends.
const CELL_PX: f64 = 2.0;
const NEARER: f64 = 0.25;
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
    version: 7,
    ports: [Port::required("input", SCENE)],
    outputs: [
        Metrics::OUTPUT,
        DEPTH,
        DEPTH_PREVIEW,
        INVERSE_DEPTH,
        SIGMA,
        NORMAL,
        DEPTH_CLASS,
        POINTS,
        SURFACE_MAPS,
    ],
}

impl Set for MakeDepth {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let scene = Scene::decode(&ctx.get(inputs.required(SCENE)?)?);
        let scene = scene.map_err(|error| StageError::new(error.to_string()))?;
        let names = picture_names(&scene);
        let mut matching = Matching::new(ctx, &scene, self.params.side_px, self.params.neighbours)?;
        let widths = matching
            .outcomes
            .iter()
            .flat_map(|one| one.widths.iter().copied());
        // Without any, there is no point either.
        let width = quantile(widths, NEARER).unwrap_or(1.0);
        let mut made = Products::new(&scene, CELL_PX * width, &self.params);
        let mut outputs = Outputs::new();
        for (index, name) in names.iter().enumerate() {
            let depth = matching.depth_of(index)?;
            let metrics = write::photo(ctx, name, &depth, &made.frame, &mut outputs)?;
            made.photos.push(PhotoMetrics {
                id: scene.frames[index].id.clone(),
                pairs: matching.pairs_of(index).count() as u32,
                reason: matching.reason(index),
                ..metrics
            });
            made.add(&depth, &mut matching, index)?;
        }
        let Matching { pairs, outcomes, .. } = matching;
        let pairs_metrics = pairs
            .chosen
            .iter()
            .zip(&outcomes)
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
        depth: &PhotoDepth,
        matching: &mut Matching<'_>,
        index: usize,
    ) -> Result<(), StageError> {
        if depth.inverse.iter().all(|inverse| *inverse == 0.0) {
            return Ok(());
        }
        let view = matching.views[index];
        let photo = matching.photos.get(index)?;
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
            sky_share: share(&|photo| photo.sky_share),
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
