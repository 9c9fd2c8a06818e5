//! Photos at the size at which they are matched. The last ones stay in memory.

use std::collections::VecDeque;
use std::sync::Arc;

use marf_cache::Digest;
use marf_scene::{Frame, Image, Photo, Srgb};
use marf_stage::{Ctx, StageError};

use crate::raster::{Picture, Raster};
use crate::rectify::PosedCamera;

/// Bytes of photos that stay in memory.
const KEPT_BYTES: usize = 128 << 20;

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
        let image = self.decoded(frame, &frame.image, "photo")?.box_reduced(factor);
        let (width, height) = (image.width as usize, image.height as usize);
        let grey = |[r, g, b]: &[u8; 3]| {
            ((u32::from(*r) * 4899 + u32::from(*g) * 9617 + u32::from(*b) * 1868 + 8192) >> 14) as u8
        };
        let mut picture = Picture::new(Raster {
            width,
            height,
            values: image.pixels.iter().map(grey).collect(),
        });
        if let Some(mask) = &frame.mask {
            // A pixel takes part if its whole block does.
            let mask = self.decoded(frame, mask, "mask")?;
            for (pixel, usable) in picture.usable.values.iter_mut().enumerate() {
                let (x, y) = ((pixel % width) as u32 * factor, (pixel / width) as u32 * factor);
                let mut block = (y..y + factor).flat_map(|y| (x..x + factor).map(move |x| (x, y)));
                *usable = block.all(|(x, y)| mask.at(x, y) == [255; 3]);
            }
        }
        Ok(ShrunkPhoto { image, picture })
    }

    fn decoded(&self, frame: &Frame, digest: &Digest, what: &str) -> Result<Image<Srgb>, StageError> {
        let failed = |cause: String| StageError::new(format!("the {what} of `{}`: {cause}", frame.id));
        let photo = Photo::decode(&self.ctx.get(digest)?).map_err(|error| failed(error.to_string()))?;
        let (width, height) = (photo.image.width, photo.image.height);
        if (width, height) == (frame.camera.width, frame.camera.height) {
            return Ok(photo.image);
        }
        Err(failed(format!(
            "{width} x {height} pixels, its camera has {} x {}",
            frame.camera.width, frame.camera.height
        )))
    }
}
