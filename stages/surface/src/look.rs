//! A field at the views of photos: how large they are, what their masks hide.

use marf_cache::Digest;
use marf_field::{Field, render_in_bands};
use marf_scene::{Camera, Frame, Observer, Photo, Pose};
use marf_stage::{Ctx, StageError};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use crate::SurfaceError;
use crate::view::SurfaceView;

/// Rays with less opacity end nowhere: haze before a sky has less, ground has more.
const MIN_OPACITY: f32 = 0.9;

/// A field at the view of a photo.
pub struct RenderedView {
    /// The camera, shrunk.
    pub camera: Camera,
    /// `[height * width]`, along the ray, world units. Infinite if the ray ends nowhere, NaN if a mask hides
    /// the pixel.
    pub distance: Vec<f32>,
    /// `[height * width]`, in [0, 1].
    pub opacity: Vec<f32>,
    /// `[height * width]`, sRGB in [0, 1].
    pub rgb: Vec<[f32; 3]>,
}

/// Renders a field at the view of a photo that is shrunk by a factor.
pub fn rendered(
    ctx: &Ctx<'_>,
    field: &Field,
    frame: &Frame,
    factor: u32,
) -> Result<RenderedView, StageError> {
    let camera = frame.camera.box_reduced(factor);
    let render = render_in_bands(field, &camera, &frame.cam_from_world, || ctx.check())?;
    let render = render.map_err(SurfaceError::from)?;
    let pixels = render.depth.iter().zip(&render.opacity);
    let distance = pixels.map(|(depth, opacity)| {
        if *opacity > MIN_OPACITY {
            *depth
        } else {
            f32::INFINITY
        }
    });
    Ok(RenderedView {
        camera,
        distance: distance.collect(),
        opacity: render.opacity,
        rgb: render.rgb,
    })
}

impl RenderedView {
    /// Returns the opacities, 0 where the field shows no surface and where a mask hides it.
    pub fn shown(&self) -> Vec<f32> {
        let pixels = self.opacity.iter().zip(&self.distance);
        pixels
            .map(|(opacity, distance)| if distance.is_finite() { *opacity } else { 0.0 })
            .collect()
    }

    /// Returns the values of [`shown`](Self::shown), and 0 where `is_wanted` rejects the point of the surface
    /// (world).
    pub fn shown_where(
        &self,
        cam_from_world: &Pose,
        is_wanted: impl Fn(&Vector3<f64>) -> bool + Sync,
    ) -> Vec<f32> {
        let world_from_cam = cam_from_world.inverse();
        let width = self.camera.width as usize;
        let is_shown = |pixel: usize| {
            let centre = Vector2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
            let ray = self.camera.unproject(&centre);
            let point = ray.map(|ray| ray.normalize() * f64::from(self.distance[pixel]));
            point.is_some_and(|point| is_wanted(&world_from_cam.point(&point)))
        };
        let all = self.shown().into_par_iter().enumerate();
        all.map(|(pixel, opacity)| {
            if opacity > 0.0 && is_shown(pixel) {
                opacity
            } else {
                0.0
            }
        })
        .collect()
    }
}

/// The field at the views of the photos.
#[derive(Default)]
pub struct FieldViews {
    /// What it shows.
    pub views: Vec<SurfaceView>,
    /// How far each photo saw.
    pub observers: Vec<Observer>,
    /// The same with far and rough surfaces, if splats are requested.
    pub shown: Vec<SurfaceView>,
    /// Of each view `[height * width]`, 0 where it shows no surface.
    pub opacities: Vec<Vec<f32>>,
    /// Of each view `[height * width]` as [`RenderedView::distance`], if splats are requested.
    pub distances: Vec<Vec<f32>>,
    /// The factor by which each photo was shrunk.
    pub factors: Vec<u32>,
}

impl FieldViews {
    /// Returns the least and the largest factor by which a photo was shrunk.
    pub fn shrunk(&self) -> [u32; 2] {
        let factors = || self.factors.iter().copied();
        [factors().min(), factors().max()].map(|factor| factor.unwrap_or(1))
    }
}

/// Returns the factor by which a photo is shrunk to at most `side_px` a side and `most` pixels.
pub fn factor(camera: &Camera, side_px: u32, most: u64) -> u32 {
    let longest = camera.width.max(camera.height);
    let shortest = camera.width.min(camera.height).max(1);
    let mut factor = longest.div_ceil(side_px).max(1);
    while u64::from(camera.width / factor) * u64::from(camera.height / factor) > most && factor < shortest {
        factor += 1;
    }
    factor.min(shortest)
}

/// Takes away what the mask of a photo hides, if any pixel of a block is.
pub fn hide(ctx: &Ctx<'_>, frame: &Frame, factor: u32, shown: &mut RenderedView) -> Result<(), StageError> {
    let Some(mask) = &frame.mask else { return Ok(()) };
    let mask = read_mask(ctx, frame, mask)?;
    let width = shown.camera.width;
    for (pixel, distance) in shown.distance.iter_mut().enumerate() {
        let (column, row) = (pixel as u32 % width, pixel as u32 / width);
        let rows = row * factor..(row + 1) * factor;
        let mut block = rows.flat_map(|y| (column * factor..(column + 1) * factor).map(move |x| (x, y)));
        if block.any(|(x, y)| mask.image.at(x, y) != [255; 3]) {
            *distance = f32::NAN;
        }
    }
    Ok(())
}

fn read_mask(ctx: &Ctx<'_>, frame: &Frame, mask: &Digest) -> Result<Photo, StageError> {
    let bad = |cause: String| SurfaceError::Mask {
        id: frame.id.clone(),
        cause,
    };
    let mask = Photo::decode(&ctx.get(mask)?).map_err(|error| bad(error.to_string()))?;
    let (width, height) = (mask.image.width, mask.image.height);
    if (width, height) != (frame.camera.width, frame.camera.height) {
        return Err(bad(format!("{width} x {height} pixels, the photo has others")).into());
    }
    Ok(mask)
}
