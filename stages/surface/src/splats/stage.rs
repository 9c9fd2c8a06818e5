//! The part of the stage `surface` that makes splats: places them, adjusts their colours, judges and writes them.

use marf_scene::picture::side_by_side;
use marf_scene::{Camera, Pose, encode_png};
use marf_schema::output::{SPLAT_VIEWS, SPLATS};
use marf_schema::surface::{SplatPsnr, SplatReport};
use marf_stage::{Ctx, Outputs, StageError, TypedOutputs};

use super::{Picture, Splat, SplatComparison, adjust_colors, file, judge, place, without_floating};
use crate::SurfaceError;
use crate::extract::SurfaceLimits;
use crate::frame::ExportFrame;
use crate::look::FieldViews;

/// Steps of the colours: on the demo the first gains 1.5 dB at held-out views, all that follow together 0.2 dB.
const COLOR_STEPS: u32 = 4;

/// The field at the view of a photo that it was not trained on.
pub struct HeldOutView {
    /// Of its pictures.
    pub name: String,
    /// The camera.
    pub camera: Camera,
    /// Its pose.
    pub cam_from_world: Pose,
    /// `[height * width]`, sRGB in [0, 1].
    pub rgb: Vec<[f32; 3]>,
    /// `[height * width]`, 0 where the field shows no surface.
    pub opacity: Vec<f32>,
    /// The same, 0 where no photo that it was trained on saw the surface, too.
    pub seen_opacity: Vec<f32>,
}

/// The splats of a field.
pub struct SplatSet {
    splats: Vec<Splat>,
    /// Splats that were taken away, since views look through them.
    floating: u64,
}

impl SplatSet {
    /// Makes the splats of what the views show.
    ///
    /// # Errors
    /// [`SurfaceError::NoSurface`] if the views show none. The wish to stop.
    pub fn new(ctx: &Ctx<'_>, seen: &FieldViews, limits: &SurfaceLimits) -> Result<Self, StageError> {
        let views = seen.shown.iter().zip(&seen.opacities);
        let views: Vec<_> = views.map(|(view, opacity)| (view, &opacity[..])).collect();
        let placed = place(&views, &seen.observers, limits);
        if placed.is_empty() {
            return Err(SurfaceError::NoSurface { photos: views.len() }.into());
        }
        let shown = pictures(seen);
        let (mut splats, floating) = without_floating(&placed, &shown, &seen.distances, || ctx.check())?;
        drop(placed);
        let total = u64::from(COLOR_STEPS) * shown.len() as u64;
        adjust_colors(&mut splats, &shown, COLOR_STEPS, |step, view| {
            let at = u64::from(step) * shown.len() as u64 + view as u64;
            ctx.progress.at(at, total, "colours of splats");
            ctx.check()
        })?;
        Ok(Self { splats, floating })
    }

    /// Compares the splats with the field and writes them, with pictures splats | field at the held-out views.
    ///
    /// # Errors
    /// The wish to stop. A store that cannot be written.
    pub fn write(
        self,
        ctx: &Ctx<'_>,
        seen: &FieldViews,
        held_out: &[HeldOutView],
        frame: &ExportFrame,
        outputs: &mut Outputs,
    ) -> Result<SplatReport, StageError> {
        let Self { splats, floating } = self;
        let mut trained_on = Vec::new();
        for picture in &pictures(seen) {
            ctx.check()?;
            trained_on.extend(judge(&splats, picture));
        }
        let (mut judged, mut judged_seen) = (Vec::new(), Vec::new());
        for view in held_out {
            ctx.check()?;
            let Some(found) = judge(&splats, &view.picture(&view.opacity)) else {
                continue;
            };
            judged_seen.extend(judge(&splats, &view.picture(&view.seen_opacity)));
            let pair = side_by_side(&[&found.splats, &found.field]);
            let png = encode_png(&pair).map_err(|error| StageError::new(error.to_string()))?;
            outputs.put_bytes(ctx, format!("{SPLAT_VIEWS}{}.png", view.name), &png)?;
            judged.push(found);
        }
        let sigmas = splats.iter().map(|splat| splat.sigma * frame.scale());
        let report = SplatReport {
            splats: splats.len() as u64,
            floating,
            finest: sigmas.clone().fold(f64::INFINITY, f64::min),
            coarsest: sigmas.fold(0.0, f64::max),
            color_steps: COLOR_STEPS,
            trained_on: psnr(&trained_on),
            held_out: psnr(&judged),
            held_out_seen: psnr(&judged_seen),
        };
        outputs.put_bytes(ctx, SPLATS, &file::ply(&splats, frame, &comments(&report)))?;
        Ok(report)
    }
}

/// Returns the pictures of the field at the views of the photos.
fn pictures(seen: &FieldViews) -> Vec<Picture<'_>> {
    let views = seen.shown.iter().zip(&seen.opacities);
    let pictures = views.map(|(view, opacity)| Picture {
        camera: view.camera(),
        cam_from_world: view.cam_from_world(),
        rgb: view.colors(),
        opacity,
    });
    pictures.collect()
}

impl HeldOutView {
    fn picture<'a>(&'a self, opacity: &'a [f32]) -> Picture<'a> {
        Picture {
            camera: &self.camera,
            cam_from_world: &self.cam_from_world,
            rgb: &self.rgb,
            opacity,
        }
    }
}

/// Returns the mean and the least of the comparisons. `None` without any.
fn psnr(judged: &[SplatComparison]) -> Option<SplatPsnr> {
    let mean =
        |value: fn(&SplatComparison) -> f64| judged.iter().map(value).sum::<f64>() / judged.len() as f64;
    (!judged.is_empty()).then(|| SplatPsnr {
        photos: judged.len() as u64,
        mean_db: mean(|one| one.psnr_db),
        least_db: judged.iter().map(|one| one.psnr_db).fold(f64::INFINITY, f64::min),
        share: mean(|one| one.share),
    })
}

fn comments(report: &SplatReport) -> Vec<String> {
    let against = [
        ("trained on", report.trained_on),
        ("held out", report.held_out),
        (
            "held out, but for what no photo trained on saw",
            report.held_out_seen,
        ),
    ];
    let scores = against.into_iter().filter_map(|(kind, psnr)| {
        let SplatPsnr { photos, mean_db, .. } = psnr?;
        Some(format!(
            "against the field's own pictures at the views of {photos} photos {kind}, where these show a surface: PSNR {mean_db:.2} dB"
        ))
    });
    let mut comments = vec![
        "flat Gaussians where views of the field show a surface; no sky; colours are sRGB and the same from all sides".to_owned(),
        "scale_*: natural logarithm of standard deviations in the unit; opacity: logit; rot_*: w x y z".to_owned(),
    ];
    comments.extend(scores);
    comments
}
