//! Photos of a scene, decoded and shrunk once for all trainings of a run.

use std::collections::BTreeSet;

use marf_cache::{Digest, digest_of};
use marf_field::Config;
use marf_scene::{Falloff, Frame, Image, Photo, Scene, Srgb};
use marf_stage::{Ctx, StageError};
use rayon::prelude::*;

pub(crate) use crate::scaled_photo::ScaledPhoto;
use crate::{TrainError, split::NamedFrame};

/// Most bytes of shrunk photos that are kept of a scene at one working size: 800 photos of 480 x 360 pixels, 200 of
/// 960 x 720. Photos beyond it, in the order of the scene, are decoded whenever they are needed.
const KEPT_BYTES: u64 = 420_000_000;

/// Reads photos of a scene at one working size.
///
/// A shrunk photo is kept as a memo under the digest of the photo's bytes and the factor, so that later trainings
/// read it instead of decoding the photo again. Without memos the same pixels come out later.
#[derive(Clone)]
pub(crate) struct PhotoReader<'a> {
    pub ctx: &'a Ctx<'a>,
    /// Whole factor by which photos are shrunk.
    pub scale: u32,
    /// Photos that have a memo.
    kept: BTreeSet<Digest>,
    /// Of cameras. Empty if it is not taken into account.
    vignetting: Vec<Falloff>,
}

impl<'a> PhotoReader<'a> {
    pub fn new(ctx: &'a Ctx<'a>, scene: &Scene, scale: u32) -> Self {
        Self {
            ctx,
            scale,
            kept: kept(scene, scale, KEPT_BYTES),
            vignetting: Vec::new(),
        }
    }

    /// Returns a reader of photos for a field with this configuration.
    pub fn for_field(ctx: &'a Ctx<'a>, scene: &Scene, scale: u32, config: &Config) -> Self {
        let tones = scene
            .tones
            .iter()
            .filter(|_| config.vignetting != marf_field::Vignetting::Off);
        Self {
            vignetting: tones.flat_map(|tones| tones.vignetting.clone()).collect(),
            ..Self::new(ctx, scene, scale)
        }
    }

    /// Returns a reader of the same scene at another working size.
    pub fn at(&self, scene: &Scene, scale: u32) -> Self {
        if scale == self.scale {
            return self.clone();
        }
        Self {
            scale,
            kept: kept(scene, scale, KEPT_BYTES),
            ..self.clone()
        }
    }

    /// Reads one photo.
    ///
    /// # Errors
    /// A photo that cannot be decoded, has another size than its camera, or vanishes at this scale.
    pub fn read(&self, frame: &Frame) -> Result<ScaledPhoto, StageError> {
        self.ctx.check()?;
        let key = self
            .kept
            .contains(&frame.image)
            .then(|| memo_key(&frame.image, self.scale));
        let known = key.and_then(|key| unpack(&self.ctx.memos.load(&key)?, self.scale));
        let (size_px, ShrunkPhoto { image, alpha }) = match known {
            Some(known) => known,
            None => self.decode(frame, key)?,
        };
        check_size(frame, size_px)?;
        Ok(ScaledPhoto {
            camera: frame.camera.box_reduced(self.scale),
            image,
            alpha,
            hidden: self.hidden(frame)?,
            falloff: Falloff::real_one(&self.vignetting, &frame.camera).copied(),
        })
    }

    /// Returns the pixels that the mask of a photo hides at the working size. Empty without a mask.
    ///
    /// # Errors
    /// As [`PhotoReader::hidden_at`].
    pub fn hidden(&self, frame: &Frame) -> Result<Vec<bool>, StageError> {
        self.hidden_at(frame, self.scale)
    }

    /// Returns the pixels that the mask of a photo hides at 1 / `scale` of its size. Empty without a mask.
    ///
    /// # Errors
    /// A mask that cannot be decoded or has another size than its photo.
    pub fn hidden_at(&self, frame: &Frame, scale: u32) -> Result<Vec<bool>, StageError> {
        let Some(mask) = &frame.mask else {
            return Ok(Vec::new());
        };
        let mask = Photo::decode(&self.ctx.get(mask)?).map_err(|cause| TrainError::Photo {
            id: format!("{}: mask", frame.id),
            cause,
        })?;
        check_size(frame, [mask.image.width, mask.image.height])?;
        let hidden: Vec<bool> = mask.image.pixels.iter().map(|pixel| *pixel != [255; 3]).collect();
        Ok(shrunk_mask(&hidden, mask.image.width, scale))
    }

    /// Returns the size of the photo before it was shrunk, and its pixels after.
    fn decode(&self, frame: &Frame, key: Option<Digest>) -> Result<([u32; 2], ShrunkPhoto), StageError> {
        let decoded = Photo::decode_validated(&self.ctx.get(&frame.image)?);
        let photo = decoded.map_err(|cause| TrainError::Photo {
            id: frame.id.clone(),
            cause,
        })?;
        let (width, height) = (photo.image.width, photo.image.height);
        check_size(frame, [width, height])?;
        if width < self.scale || height < self.scale {
            return Err(TrainError::Vanished {
                id: frame.id.clone(),
                width,
                height,
                scale: self.scale,
            }
            .into());
        }
        let Photo { image, alpha, .. } = match self.scale {
            1 => photo,
            scale => photo.box_reduced(scale),
        };
        let shrunk = ShrunkPhoto { image, alpha };
        if let Some(key) = key {
            self.ctx.memos.save(&key, &pack([width, height], &shrunk));
        }
        Ok(([width, height], shrunk))
    }

    /// Reads photos and returns the result of `keep` for each, in order. At most `at_once` photos are in memory.
    ///
    /// # Errors
    /// As [`PhotoReader::read`].
    pub fn map<T: Send>(
        &self,
        frames: &[NamedFrame<'_>],
        at_once: usize,
        keep: impl Fn(usize, ScaledPhoto) -> T + Sync,
    ) -> Result<Vec<T>, StageError> {
        let at_once = at_once.max(1);
        let mut kept = Vec::with_capacity(frames.len());
        for (group, frames) in frames.chunks(at_once).enumerate() {
            let photos = frames.par_iter().enumerate().with_max_len(1);
            let of_group: Vec<Result<T, StageError>> = photos
                .map(|(index, named)| Ok(keep(group * at_once + index, self.read(named.frame)?)))
                .collect();
            // Of several unreadable photos the first is reported, whichever was met first.
            for photo in of_group {
                kept.push(photo?);
            }
        }
        Ok(kept)
    }
}

/// Returns a mask at 1 / `factor` of its size, hidden where any pixel of a block is. As for photos, rows and columns that fill no block are
/// left out.
fn shrunk_mask(hidden: &[bool], width: u32, factor: u32) -> Vec<bool> {
    if hidden.is_empty() || factor == 1 {
        return hidden.to_vec();
    }
    let (width, factor) = (width as usize, factor as usize);
    let (columns, rows) = (width / factor, hidden.len() / width / factor);
    let is_hidden = |column: usize, row: usize| {
        let mut rows = hidden.chunks(width).skip(row * factor).take(factor);
        rows.any(|row| row[column * factor..(column + 1) * factor].contains(&true))
    };
    let blocks = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row)));
    blocks.map(|(column, row)| is_hidden(column, row)).collect()
}

/// Returns the photos of a scene, from the first, that together have at most `most_bytes` at a working size.
fn kept(scene: &Scene, scale: u32, most_bytes: u64) -> BTreeSet<Digest> {
    let mut bytes = 0;
    let fits = |frame: &&Frame| {
        let camera = frame.camera.box_reduced(scale);
        bytes += 3 * u64::from(camera.width) * u64::from(camera.height);
        bytes <= most_bytes
    };
    let frames = scene.frames.iter().take_while(fits);
    frames.map(|frame| frame.image).collect()
}

/// Pixels of a photo at its working size, over black, and their opacities, if not all are opaque.
struct ShrunkPhoto {
    image: Image<Srgb>,
    alpha: Vec<u8>,
}

/// Returns the key of a memo. Its number is raised when a photo may decode or shrink to other pixels.
fn memo_key(photo: &Digest, scale: u32) -> Digest {
    digest_of(&("shrunk photo 2", *photo, scale))
}

/// Width and height before shrinking as u32 LE, then the pixels after it, 3 bytes each, and their opacities, if any.
fn pack(size_px: [u32; 2], ShrunkPhoto { image, alpha }: &ShrunkPhoto) -> Vec<u8> {
    let size = size_px.map(u32::to_le_bytes);
    [size.as_flattened(), image.pixels.as_flattened(), alpha].concat()
}

/// Reads the bytes of [`pack`]. `None` if they are anything else.
fn unpack(bytes: &[u8], scale: u32) -> Option<([u32; 2], ShrunkPhoto)> {
    let (width, rest) = bytes.split_first_chunk::<4>()?;
    let (height, rest) = rest.split_first_chunk::<4>()?;
    let size_px = [width, height].map(|side| u32::from_le_bytes(*side));
    let [width, height] = size_px.map(|side| side / scale.max(1));
    let count = width as usize * height as usize;
    let (colours, alpha) = rest.split_at_checked(count.checked_mul(3)?)?;
    let image = Image {
        width,
        height,
        pixels: colours.as_chunks::<3>().0.to_vec(),
    };
    let is_whole = count > 0 && (alpha.is_empty() || alpha.len() == count);
    let alpha = alpha.to_vec();
    is_whole.then_some((size_px, ShrunkPhoto { image, alpha }))
}

fn check_size(frame: &Frame, [width, height]: [u32; 2]) -> Result<(), TrainError> {
    let (camera_width, camera_height) = (frame.camera.width, frame.camera.height);
    if (width, height) == (camera_width, camera_height) {
        return Ok(());
    }
    Err(TrainError::Size {
        id: frame.id.clone(),
        width,
        height,
        camera_width,
        camera_height,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_scene::{Camera, Pose, encode_png};
    use marf_stage::{Memos, harness::Harness};

    fn frame(harness: &Harness, index: u32) -> Frame {
        let image = Image::from_fn(10, 6, |column, row| {
            [column as u8 * 20, row as u8 * 30, index as u8]
        });
        Frame {
            id: format!("{index}"),
            file: format!("{index}.png"),
            image: harness.put(&encode_png(&image).unwrap()),
            camera: Camera::pinhole(10, 6, 8.0),
            cam_from_world: Pose::identity(),
            held_out: false,
            mask: None,
            error_px: None,
        }
    }

    fn scene(harness: &Harness, count: u32) -> Scene {
        Scene {
            frames: (0..count).map(|index| frame(harness, index)).collect(),
            ..Scene::default()
        }
    }

    #[test]
    fn a_photo_is_decoded_once_a_scale_and_read_the_same_afterwards() {
        let harness = Harness::default();
        let (scene, ctx) = (scene(&harness, 2), harness.ctx());
        for scale in [1, 2, 3] {
            let reader = PhotoReader::new(&ctx, &scene, scale);
            let before = harness.reads(&scene.frames[0].image);
            let first = reader.read(&scene.frames[0]).unwrap();
            let again = reader.read(&scene.frames[0]).unwrap();
            assert_eq!(first, again, "scale {scale}");
            assert_eq!(harness.reads(&scene.frames[0].image), before + 1, "scale {scale}");
            assert_eq!((first.image.width, first.image.height), (10 / scale, 6 / scale));
        }
    }

    #[test]
    fn transparency_is_read_from_the_photo_and_from_its_memo() {
        let harness = Harness::default();
        let (mut scene, ctx) = (scene(&harness, 1), harness.ctx());
        let image = Image::from_fn(10, 6, |column, _| [if column < 4 { 0 } else { 90 }; 3]);
        let alpha = (0..60)
            .map(|place| if place % 10 < 4 { 0 } else { 255 })
            .collect();
        let photo = Photo {
            alpha,
            ..image.into()
        };
        scene.frames[0].image = harness.put(&photo.to_png().unwrap());
        let reader = PhotoReader::new(&ctx, &scene, 2);
        let (first, again) = (reader.read(&scene.frames[0]), reader.read(&scene.frames[0]));
        let first = first.unwrap();
        assert_eq!(first.alpha, [0, 0, 255, 255, 255].repeat(3));
        assert_eq!(again.unwrap(), first);
    }

    #[test]
    fn a_damaged_memo_costs_only_time() {
        let harness = Harness::default();
        let (scene, ctx) = (scene(&harness, 1), harness.ctx());
        let (reader, frame) = (PhotoReader::new(&ctx, &scene, 2), &scene.frames[0]);
        let expected = reader.read(frame).unwrap();
        let key = memo_key(&frame.image, 2);
        let whole = harness.load(&key).unwrap();
        let cut = whole.len() - 1;
        for damaged in [&[][..], &whole[..7], &whole[..cut], &[0; 8], &[255; 8]] {
            harness.save(&key, damaged);
            assert_eq!(reader.read(frame).unwrap(), expected, "{} bytes", damaged.len());
            assert_eq!(
                harness.load(&key).unwrap(),
                whole,
                "{} bytes are replaced",
                damaged.len()
            );
        }
    }

    #[test]
    fn a_mask_shrinks_with_its_photo_and_hides_every_block_that_it_touches() {
        let harness = Harness::default();
        let (mut scene, ctx) = (scene(&harness, 1), harness.ctx());
        let mask = Image::from_fn(10, 6, |column, row| {
            if (column, row) == (3, 2) {
                [254; 3]
            } else {
                [255; 3]
            }
        });
        scene.frames[0].mask = Some(harness.put(&encode_png(&mask).unwrap()));
        let read = |scale: u32| {
            PhotoReader::new(&ctx, &scene, scale)
                .read(&scene.frames[0])
                .unwrap()
        };
        let places =
            |hidden: &[bool]| -> Vec<usize> { (0..hidden.len()).filter(|place| hidden[*place]).collect() };
        assert_eq!(places(&read(1).hidden), [2 * 10 + 3]);
        assert_eq!((places(&read(2).hidden), read(2).hidden.len()), (vec![5 + 1], 15));
        assert_eq!((places(&read(4).hidden), read(4).hidden.len()), (vec![0], 2));
        let wrong = Image::from_fn(9, 6, |_, _| [255; 3]);
        scene.frames[0].mask = Some(harness.put(&encode_png(&wrong).unwrap()));
        let error = PhotoReader::new(&ctx, &scene, 1)
            .read(&scene.frames[0])
            .unwrap_err();
        assert!(error.to_string().contains("9 x 6"), "{error}");
    }

    #[test]
    fn a_camera_of_another_size_is_refused_from_the_memo_too() {
        let harness = Harness::default();
        let (mut scene, ctx) = (scene(&harness, 1), harness.ctx());
        PhotoReader::new(&ctx, &scene, 2).read(&scene.frames[0]).unwrap();
        scene.frames[0].camera = Camera::pinhole(11, 7, 8.0);
        let reader = PhotoReader::new(&ctx, &scene, 2);
        let error = reader.read(&scene.frames[0]).unwrap_err().to_string();
        assert!(error.contains("10 x 6") && error.contains("11 x 7"), "{error}");
    }

    #[test]
    fn the_first_photos_of_a_scene_are_kept_up_to_the_bound() {
        let harness = Harness::default();
        let scene = scene(&harness, 4);
        // At scale 2 a photo is 5 x 3 pixels, 45 bytes.
        for (most_bytes, count) in [(44, 0), (45, 1), (134, 2), (1000, 4)] {
            let kept = kept(&scene, 2, most_bytes);
            assert_eq!(kept.len(), count, "{most_bytes}");
            assert!(
                scene.frames[..count]
                    .iter()
                    .all(|frame| kept.contains(&frame.image))
            );
        }
    }

    /// 10 x 6 pixels, in boxes of 3: their middles are pixels 1, 4 and 7 of rows 1 and 4, seen along the same rays.
    #[test]
    fn a_photo_is_thinned_to_middles_of_boxes_that_are_seen_along_the_same_rays() {
        let harness = Harness::default();
        let (scene, ctx) = (scene(&harness, 1), harness.ctx());
        let mut photo = PhotoReader::new(&ctx, &scene, 1).read(&scene.frames[0]).unwrap();
        photo.image.pixels = (0..60).map(|pixel| [pixel; 3]).collect();
        photo.alpha = (0..60).collect();
        let thin = photo.thinned_to(5);
        let expected = [11, 14, 17, 41, 44, 47];
        assert_eq!(thin.alpha, expected);
        assert_eq!(thin.image.pixels, expected.map(|pixel| [pixel; 3]));
        assert_eq!(thin.hidden, [false; 0]);
        for (index, pixel) in expected.into_iter().enumerate() {
            let middle = |place: usize, width: usize| {
                nalgebra::Vector2::new((place % width) as f64 + 0.5, (place / width) as f64 + 0.5)
            };
            let [small, whole] = [
                thin.camera.unproject(&middle(index, 3)),
                photo.camera.unproject(&middle(pixel.into(), 10)),
            ];
            assert!((small.unwrap() - whole.unwrap()).norm() < 1e-12, "{pixel}");
        }
        for (side_px, width, height) in [(10, 10, 6), (9, 3, 2), (1, 2, 1)] {
            let thin = photo.thinned_to(side_px);
            let size = [thin.image.width, thin.image.height];
            assert_eq!(size, [width, height], "{side_px}");
            assert_eq!([thin.camera.width, thin.camera.height], size);
            assert_eq!(thin.image.pixels.len() as u32, width * height);
        }
    }
}
