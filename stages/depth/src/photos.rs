//! Photos at the size at which they are matched. The last ones stay in memory.

use std::collections::VecDeque;
use std::sync::Arc;

use marf_cache::Digest;
use marf_numeric::quantile;
use marf_scene::{Frame, Image, Photo, Srgb};
use marf_stage::{Ctx, StageError};

use crate::margins;
use crate::raster::{Picture, Raster};
use crate::rectify::PosedCamera;

/// Bytes of photos that stay in memory.
const KEPT_BYTES: usize = 128 << 20;
/// Sums of weights of the channels for a step of 8-bit brightness.
const STEP: f64 = 16_384.0;
/// Brightness between these shares of the pixels, on each side, is stretched to this number of steps.
const OUTLIERS: f64 = 0.01;
const MIDDLE_STEPS: f64 = 224.0;
/// Bounds of the stretch. Beyond the upper one, it would only show noise.
const LEAST_GAIN: f64 = 1.0 / STEP;
const MOST_GAIN: f64 = 4.0 / STEP;

/// A photo, shrunk.
pub(crate) struct ShrunkPhoto {
    pub image: Image<Srgb>,
    pub picture: Picture,
}

impl ShrunkPhoto {
    fn bytes(&self) -> usize {
        5 * self.image.pixels.len()
    }
}

/// The photos of a scene.
pub(crate) struct Photos<'a> {
    ctx: &'a Ctx<'a>,
    frames: &'a [Frame],
    factors: Vec<u32>,
    /// Those in memory, the one used last at the end.
    kept: VecDeque<CachedPhoto>,
}

struct CachedPhoto {
    index: usize,
    photo: Arc<ShrunkPhoto>,
}

impl<'a> Photos<'a> {
    /// Returns the photos with sides of at most `side_px`.
    pub fn new(ctx: &'a Ctx<'a>, frames: &'a [Frame], side_px: u32) -> Self {
        let factor = |frame: &Frame| {
            let (width, height) = (frame.camera.width, frame.camera.height);
            width.max(height).div_ceil(side_px).clamp(1, width.min(height))
        };
        Self {
            ctx,
            frames,
            factors: frames.iter().map(factor).collect(),
            kept: VecDeque::new(),
        }
    }

    /// Returns the shrunk cameras.
    pub fn views(&self) -> Vec<PosedCamera> {
        let views = self
            .frames
            .iter()
            .zip(&self.factors)
            .map(|(frame, factor)| PosedCamera {
                camera: frame.camera.box_reduced(*factor),
                cam_from_world: frame.cam_from_world,
            });
        views.collect()
    }

    /// Returns a photo.
    ///
    /// # Errors
    /// A photo or a mask that cannot be read, or that is not of the size of its camera.
    pub fn get(&mut self, index: usize) -> Result<Arc<ShrunkPhoto>, StageError> {
        let known = self.kept.iter().position(|kept| kept.index == index);
        let kept = match known.and_then(|place| self.kept.remove(place)) {
            Some(kept) => kept,
            None => CachedPhoto {
                index,
                photo: Arc::new(self.read(index)?),
            },
        };
        let photo = Arc::clone(&kept.photo);
        self.kept.push_back(kept);
        let bytes = |kept: &VecDeque<CachedPhoto>| kept.iter().map(|kept| kept.photo.bytes()).sum::<usize>();
        while self.kept.len() > 2 && bytes(&self.kept) > KEPT_BYTES {
            self.kept.pop_front();
        }
        Ok(photo)
    }

    fn read(&self, index: usize) -> Result<ShrunkPhoto, StageError> {
        let (frame, factor) = (&self.frames[index], self.factors[index]);
        let Photo {
            image: photo, alpha, ..
        } = self.decoded(frame, &frame.image, "photo")?;
        let mut usable = margins::usable(&photo);
        // What shows the space behind the scene has no depth.
        for (usable, alpha) in usable.values.iter_mut().zip(alpha) {
            *usable &= alpha == 255;
        }
        if let Some(mask) = &frame.mask {
            let mask = self.decoded(frame, mask, "mask")?.image;
            for (usable, mask) in usable.values.iter_mut().zip(&mask.pixels) {
                *usable &= *mask == [255; 3];
            }
        }
        let image = photo.box_reduced(factor);
        let picture = shrunk(&photo, &usable, factor as usize);
        Ok(ShrunkPhoto { image, picture })
    }

    fn decoded(&self, frame: &Frame, digest: &Digest, what: &str) -> Result<Photo, StageError> {
        let failed = |cause: String| StageError::new(format!("the {what} of `{}`: {cause}", frame.id));
        let photo = Photo::decode(&self.ctx.get(digest)?).map_err(|error| failed(error.to_string()))?;
        let (width, height) = (photo.image.width, photo.image.height);
        if (width, height) == (frame.camera.width, frame.camera.height) {
            return Ok(photo);
        }
        Err(failed(format!(
            "{width} x {height} pixels, its camera has {} x {}",
            frame.camera.width, frame.camera.height
        )))
    }
}

/// Returns means of the brightness of blocks. A block takes part if all its pixels do.
///
/// Brightness is stretched, so that means are not rounded to the steps of a photo of little contrast.
fn shrunk(photo: &Image<Srgb>, usable: &Raster<bool>, factor: usize) -> Picture {
    let grey = |[r, g, b]: [u8; 3]| u32::from(r) * 4899 + u32::from(g) * 9617 + u32::from(b) * 1868;
    let (width, height) = (usable.width / factor, usable.height / factor);
    let mut sums = Raster::filled(width, height, 0u32);
    let mut whole = Raster::filled(width, height, true);
    for y in 0..height * factor {
        for x in 0..width * factor {
            let (at, block) = (y * usable.width + x, (y / factor) * width + x / factor);
            sums.values[block] += grey(photo.pixels[at]) / (factor * factor) as u32;
            whole.values[block] &= usable.values[at];
        }
    }
    let known = || sums.values.iter().zip(&whole.values).filter(|(_, whole)| **whole);
    let bound = |share: f64| quantile(known().map(|(sum, _)| f64::from(*sum)), share).unwrap_or(0.0);
    let (dark, bright) = (bound(OUTLIERS), bound(1.0 - OUTLIERS));
    let gain = (MIDDLE_STEPS / (bright - dark).max(1.0)).clamp(LEAST_GAIN, MOST_GAIN);
    let middle = (dark + bright) / 2.0;
    let stretched = |sum: &u32| {
        (127.5 + (f64::from(*sum) - middle) * gain)
            .round()
            .clamp(0.0, 255.0) as u8
    };
    Picture {
        grey: Raster {
            width,
            height,
            values: sums.values.iter().map(stretched).collect(),
        },
        usable: whole,
    }
}
