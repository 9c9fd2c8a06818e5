//! Mask files next to the photos, which hide parts of them.

use std::collections::BTreeMap;

use marf_cache::Digest;
use marf_scene::{Image, Photo, Srgb, encode_png};
use marf_schema::calibrate::{CalibrateParams, Method};
use marf_stage::{COMPANIONS, Ctx, Inputs, StageError};
use rayon::prelude::*;

use crate::calibration::PlacedPhoto;
use crate::labels::{Candidate, ideal_mask, of_one_site};
use crate::mask_names::{camera_names, own_names};
use crate::photos::{InputPhoto, reduction};

/// What a mask leaves of a photo, and what it hides.
pub(crate) const OPEN: [u8; 3] = [255; 3];
pub(crate) const HIDDEN: [u8; 3] = [0; 3];

/// Returns the mask of a photo, in the pixel grid of the upright photo: black is ignored. `None` if there is none, or `cameras` is not
/// connected.
///
/// A photo's own mask is the one that the import names, else `masks/<name>.png` in any folder above the photo, with or without the
/// extension of its name. A folder `images` between them may be left out, and so may all. The folder may be `mask`, the file a JPEG, and
/// the name may end in `_mask`. `<name>.jpg.png` and `<name>_mask.png` in the folder of the photo are masks, too.
///
/// `masks/<instrument>-<width>x<height>.png`, or `masks/<instrument>.png`, is for all photos of that instrument that have its size and no
/// mask of their own. `masks/<width>x<height>.png` is for photos of no known instrument. A mask in the size of the stored pixels of a photo
/// with an EXIF orientation is turned with it.
///
/// # Errors
/// A mask that cannot be decoded, or a photo's own mask of another size.
pub(crate) fn mask_file(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    item: &InputPhoto,
) -> Result<Option<Image<Srgb>>, StageError> {
    let Some(found) = FoundMask::read(ctx, inputs, item)? else {
        return Ok(None);
    };
    let upright = [item.facts.width, item.facts.height];
    let stored: [u32; 2] = item.stored_size_px().into();
    if found.size_px() != upright && found.size_px() == stored {
        return Ok(Some(item.orientation().upright(&found.mask)));
    }
    found.of_size(upright, item)
}

/// Returns the mask of a photo, in the pixel grid in which the photo is stored. One in the size of the upright photo is turned.
///
/// # Errors
/// As [`mask_file`].
pub(crate) fn stored_mask(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    item: &InputPhoto,
) -> Result<Option<Image<Srgb>>, StageError> {
    let Some(found) = FoundMask::read(ctx, inputs, item)? else {
        return Ok(None);
    };
    let upright = [item.facts.width, item.facts.height];
    let stored: [u32; 2] = item.stored_size_px().into();
    if found.size_px() != stored && found.size_px() == upright {
        return Ok(Some(item.orientation().stored(&found.mask)));
    }
    found.of_size(stored, item)
}

/// A mask as its file has it.
struct FoundMask {
    name: String,
    mask: Image<Srgb>,
    /// Whether it is for one photo. Otherwise it is for all photos of a camera that have its size.
    is_own: bool,
}

impl FoundMask {
    /// Reads the mask that the import names, the photo's own, or that of its camera.
    fn read(ctx: &Ctx<'_>, inputs: &Inputs, item: &InputPhoto) -> Result<Option<Self>, StageError> {
        if let Some(digest) = &item.mask {
            let name = "mask_path".to_owned();
            let mask = decode(ctx, &name, digest)?;
            return Ok(Some(Self {
                name,
                mask,
                is_own: true,
            }));
        }
        let Some(digest) = inputs.optional(COMPANIONS) else {
            return Ok(None);
        };
        let files: BTreeMap<String, Digest> = serde_json::from_slice(&ctx.get(digest)?)
            .map_err(|error| StageError::new(format!("the list of files next to the photos: {error}")))?;
        let find = |names: Vec<String>| names.into_iter().find_map(|name| files.get_key_value(&name));
        let own = find(own_names(&item.facts.file));
        let Some((name, digest)) = own.or_else(|| find(camera_names(item))) else {
            return Ok(None);
        };
        let mask = decode(ctx, name, digest)?;
        Ok(Some(Self {
            name: name.clone(),
            mask,
            is_own: own.is_some(),
        }))
    }

    fn size_px(&self) -> [u32; 2] {
        [self.mask.width, self.mask.height]
    }

    /// Returns the mask if it has this size. Another size is an error for the photo's own mask, else `None`.
    fn of_size(self, size_px: [u32; 2], item: &InputPhoto) -> Result<Option<Image<Srgb>>, StageError> {
        if self.is_own && self.size_px() != size_px {
            let error = StageError::new(format!(
                "`{}` has {} x {} pixels, its photo `{}` {} x {}",
                self.name, self.mask.width, self.mask.height, item.id, size_px[0], size_px[1]
            ));
            return Err(error.hint("write the mask in the size of its photo, or remove it"));
        }
        Ok(Some(self.mask).filter(|mask| [mask.width, mask.height] == size_px))
    }
}

/// Makes pixels that are not white black, such as those at the rim of a resampled mask.
pub(crate) fn blackened(mask: &mut Image<Srgb>) {
    only_white(mask, |pixel| pixel == OPEN);
}

pub(crate) fn only_white(mask: &mut Image<Srgb>, is_open: impl Fn([u8; 3]) -> bool) {
    for pixel in &mut mask.pixels {
        *pixel = if is_open(*pixel) { OPEN } else { HIDDEN };
    }
}

/// Returns the mask of a photo in the pixel grid that structure from motion and the field see: black is hidden, white is open, and
/// nothing else. A photo whose label has a lens (`candidate`) is resampled, and its mask with it.
pub(crate) fn undistorted_mask(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    item: &InputPhoto,
    candidate: Option<&Candidate<'_>>,
) -> Result<Option<Image<Srgb>>, StageError> {
    let Some(mut mask) = mask_file(ctx, inputs, item)? else {
        return Ok(None);
    };
    only_white(&mut mask, |pixel| pixel != HIDDEN);
    if let Some(candidate) = candidate {
        mask = ideal_mask(ctx, mask, item, candidate)?;
        blackened(&mut mask);
    }
    Ok(Some(mask))
}

/// Returns the masks of placed photos at the size that the field is trained on, by item. Photos without a mask, or with a wholly open one,
/// are left out. A pixel of a reduced photo is hidden if any of its source pixels is.
pub(crate) fn field_masks(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    items: &[InputPhoto],
    placed: &[PlacedPhoto],
    params: &CalibrateParams,
) -> Result<BTreeMap<usize, Digest>, StageError> {
    if inputs.optional(COMPANIONS).is_none() && placed.iter().all(|one| one.mask.is_none()) {
        return Ok(BTreeMap::new());
    }
    let candidates = match params.method {
        Method::Labels | Method::Sfm | Method::Auto => of_one_site(items, params.site),
        Method::Import => items.iter().map(|_| None).collect(),
    };
    let mask = |one: &PlacedPhoto| -> Result<Option<(usize, Digest)>, StageError> {
        let item = &items[one.item];
        let mask = match &one.mask {
            Some(digest) => Some(black_or_white(ctx, digest)?),
            None => undistorted_mask(ctx, inputs, item, candidates[one.item].as_ref())?,
        };
        let Some(mask) = mask else {
            return Ok(None);
        };
        let factor = reduction(mask.width, mask.height, params.longest_side_px);
        let mask = shrunk(&mask, factor);
        if (mask.width, mask.height) != (one.camera.width, one.camera.height) {
            return Err(StageError::new(format!(
                "the mask of `{}` has {} x {} pixels where the photo has {} x {}",
                item.id, mask.width, mask.height, one.camera.width, one.camera.height
            )));
        }
        if mask.pixels.iter().all(|pixel| *pixel == OPEN) {
            return Ok(None);
        }
        let png = encode_png(&mask).map_err(|error| StageError::new(error.to_string()))?;
        Ok(Some((one.item, ctx.put(&png)?)))
    };
    let all: Result<Vec<_>, StageError> = placed.par_iter().map(mask).collect();
    Ok(all?.into_iter().flatten().collect())
}

/// Returns the mask that an import names or has made.
fn black_or_white(ctx: &Ctx<'_>, digest: &Digest) -> Result<Image<Srgb>, StageError> {
    let mut mask = decode(ctx, "mask_path", digest)?;
    only_white(&mut mask, |pixel| pixel != HIDDEN);
    Ok(mask)
}

/// Returns a mask at 1 / `factor` of its size, hidden where any pixel of a block is.
pub(crate) fn shrunk(mask: &Image<Srgb>, factor: u32) -> Image<Srgb> {
    Image::from_fn(mask.width / factor, mask.height / factor, |column, row| {
        let rows = row * factor..(row + 1) * factor;
        let mut block =
            rows.flat_map(|row| (column * factor..(column + 1) * factor).map(move |column| (column, row)));
        let is_open = block.all(|(column, row)| mask.at(column, row) == OPEN);
        if is_open { OPEN } else { HIDDEN }
    })
}

/// Decodes a mask. In a JPEG black is not exactly 0: there the darker half is.
fn decode(ctx: &Ctx<'_>, name: &str, digest: &Digest) -> Result<Image<Srgb>, StageError> {
    let bytes = ctx.get(digest)?;
    let photo = Photo::decode(&bytes);
    let photo = photo.map_err(|error| {
        StageError::new(format!("the mask `{name}`: {error}")).hint("write it as PNG, or remove it")
    })?;
    let mut mask = photo.image;
    if bytes.starts_with(b"\xff\xd8") {
        only_white(&mut mask, |pixel| pixel.into_iter().any(|channel| channel >= 128));
    }
    Ok(mask)
}

#[cfg(test)]
mod tests {
    use marf_scene::{Cahvor, Camera, CameraPrior, PhotoFacts, Pose, encode_png};
    use marf_stage::harness::Harness;

    use super::*;

    const GREY: [u8; 3] = [7; 3];

    fn item(file: &str, instrument: &str) -> InputPhoto {
        InputPhoto {
            id: file.to_owned(),
            image: Digest::from_content(b"image"),
            labelled: false,
            developed: false,
            mask: None,
            facts: PhotoFacts {
                file: file.to_owned(),
                width: 4,
                height: 3,
                instrument: Some(instrument.to_owned()),
                ..PhotoFacts::default()
            },
        }
    }

    /// Files next to the photos, each a picture of one colour.
    fn beside(harness: &Harness, files: &[(&str, u32, [u8; 3])]) -> Inputs {
        let put = |(name, width, color): &(&str, u32, [u8; 3])| {
            let picture = Image::<Srgb>::from_fn(*width, 3, |_, _| *color);
            ((*name).to_owned(), harness.put(&encode_png(&picture).unwrap()))
        };
        let files: BTreeMap<String, Digest> = files.iter().map(put).collect();
        let list = harness.put(&serde_json::to_vec(&files).unwrap());
        Inputs(BTreeMap::from([(COMPANIONS.to_owned(), list)]))
    }

    /// A photo of 64 x 48 pixels whose label has a lens that bends straight lines.
    fn with_lens() -> InputPhoto {
        let mut item = item("a.png", "ZL");
        (item.facts.width, item.facts.height) = (64, 48);
        item.facts.prior = Some(CameraPrior {
            model: Cahvor {
                c: [0.0; 3],
                a: [0.0, 0.0, 1.0],
                h: [50.0, 0.0, 32.0],
                v: [0.0, 50.0, 24.0],
                o: Some([0.0, 0.0, 1.0]),
                r: Some([0.0, 0.5, 0.0]),
                e: None,
            },
            frame: "SITE_FRAME".to_owned(),
            site_from_frame: None,
            motion_counter: vec![1],
        });
        item
    }

    /// A mask that hides the 20 columns at the left.
    fn left_hidden(harness: &Harness) -> Inputs {
        let mask = Image::<Srgb>::from_fn(64, 48, |column, _| if column < 20 { HIDDEN } else { [9; 3] });
        let files = BTreeMap::from([("masks/a.png", harness.put(&encode_png(&mask).unwrap()))]);
        let list = harness.put(&serde_json::to_vec(&files).unwrap());
        Inputs(BTreeMap::from([(COMPANIONS.to_owned(), list)]))
    }

    #[test]
    fn a_mask_is_bent_as_its_photo_is_and_is_then_black_or_white() {
        let (harness, items) = (Harness::default(), [with_lens()]);
        let inputs = left_hidden(&harness);
        let candidates = of_one_site(&items, None);
        let mask = |candidate| {
            let mask = undistorted_mask(&harness.ctx(), &inputs, &items[0], candidate)
                .unwrap()
                .unwrap();
            assert!(mask.pixels.iter().all(|pixel| [OPEN, HIDDEN].contains(pixel)));
            mask
        };
        let hidden_in = |mask: &Image<Srgb>, row: u32| {
            (0..mask.width)
                .filter(|column| mask.at(*column, row) == HIDDEN)
                .count()
        };
        let own = mask(None);
        assert_eq!((hidden_in(&own, 0), hidden_in(&own, 24)), (20, 20));
        let bent = mask(candidates[0].as_ref());
        let (edge, middle) = (hidden_in(&bent, 0), hidden_in(&bent, bent.height / 2));
        assert!(
            edge != middle && edge > 0 && middle > 0,
            "a straight edge becomes a curve: {edge} {middle}"
        );
    }

    #[test]
    fn the_mask_of_a_placed_photo_has_its_size_and_an_open_one_is_none() {
        let (harness, items) = (
            Harness::default(),
            [InputPhoto {
                id: "a".to_owned(),
                facts: PhotoFacts {
                    prior: None,
                    ..with_lens().facts
                },
                ..with_lens()
            }],
        );
        let params = CalibrateParams {
            method: Method::Import,
            longest_side_px: Some(32),
            ..CalibrateParams::default()
        };
        let placed = |camera: Camera| PlacedPhoto {
            item: 0,
            file: String::new(),
            image: Digest::from_content(b"image"),
            mask: None,
            camera,
            cam_from_world: Pose::identity(),
            held_out: None,
            statistics: crate::calibration::PhotoStatistics::default(),
        };
        let ctx = harness.ctx();
        let masks =
            |inputs: &Inputs, camera: Camera| field_masks(&ctx, inputs, &items, &[placed(camera)], &params);
        let half = Camera::pinhole(32, 24, 25.0);
        let found = masks(&left_hidden(&harness), half).unwrap();
        let mask = Photo::decode(&harness.get(&found[&0]).unwrap()).unwrap().image;
        assert_eq!((mask.width, mask.height), (32, 24));
        assert_eq!((mask.at(9, 5), mask.at(10, 5)), (HIDDEN, OPEN));
        let wrong = masks(&left_hidden(&harness), Camera::pinhole(31, 24, 25.0)).unwrap_err();
        assert!(wrong.to_string().contains("32 x 24"), "{wrong}");
        let open = Image::<Srgb>::from_fn(64, 48, |_, _| OPEN);
        let files = BTreeMap::from([("masks/a.png", harness.put(&encode_png(&open).unwrap()))]);
        let list = harness.put(&serde_json::to_vec(&files).unwrap());
        let inputs = Inputs(BTreeMap::from([(COMPANIONS.to_owned(), list)]));
        assert!(masks(&inputs, half).unwrap().is_empty());
        assert!(masks(&Inputs::default(), half).unwrap().is_empty());
    }

    #[test]
    fn a_mask_is_found_by_name_with_or_without_extension_and_folder() {
        for (file, mask) in [
            ("a.jpg", "masks/a.jpg.png"),
            ("a.jpg", "masks/a.png"),
            ("images/a.jpg", "masks/a.jpg.png"),
            ("images/left/a.jpg", "masks/left/a.png"),
            ("images/left/a.jpg", "masks/images/left/a.jpg.png"),
            ("sol7/images/a.jpg", "sol7/masks/a.png"),
            ("sol7/images/a.jpg", "masks/a.jpg.png"),
            ("any/ZL.jpg", "masks/NAVCAM_LEFT.png"),
            ("images/a.jpg", "masks/a.jpg"),
            ("images/a.jpg", "mask/a.png"),
            ("images/a.jpg", "masks/a_mask.png"),
            ("images/a.jpg", "images/a_mask.png"),
            ("images/a.jpg", "images/a.jpg.png"),
            ("images_2/a.jpg", "masks_2/a.png"),
        ] {
            let harness = Harness::default();
            let inputs = beside(&harness, &[(mask, 4, GREY), ("masks/other.png", 4, [0; 3])]);
            let found = mask_file(&harness.ctx(), &inputs, &item(file, "NAVCAM_LEFT")).unwrap();
            assert_eq!(found.map(|mask| mask.at(3, 2)), Some(GREY), "{file} {mask}");
        }
    }

    #[test]
    fn a_photos_own_mask_goes_before_its_instruments_and_without_one_nothing_is_hidden() {
        let harness = Harness::default();
        let files = [
            ("masks/ZL.png", 4, [0; 3]),
            ("masks/a.png", 4, GREY),
            ("masks/MR.png", 8, GREY),
        ];
        let inputs = beside(&harness, &files);
        let find = |file: &str, instrument: &str| {
            let mask = mask_file(&harness.ctx(), &inputs, &item(file, instrument)).unwrap();
            mask.map(|mask| mask.at(0, 0))
        };
        assert_eq!(find("a.jpg", "ZL"), Some(GREY));
        assert_eq!(find("b.jpg", "ZL"), Some([0; 3]));
        assert_eq!(find("b.jpg", "ZR"), None);
        assert_eq!(find("b.jpg", "MR"), None, "of another size than this photo");
        let files = [
            ("masks/4x3.png", 4, GREY),
            ("masks/ZL-4x3.png", 4, GREY),
            ("masks/ZL.png", 4, [0; 3]),
        ];
        let inputs = beside(&harness, &files);
        let find = |instrument: Option<&str>| {
            let mut item = item("b.jpg", "");
            item.facts.instrument = instrument.map(str::to_owned);
            let mask = mask_file(&harness.ctx(), &inputs, &item).unwrap();
            mask.map(|mask| mask.at(0, 0))
        };
        assert_eq!(
            find(Some("ZL")),
            Some(GREY),
            "the size goes before the instrument alone"
        );
        assert_eq!((find(None), find(Some("ZR"))), (Some(GREY), None));
        let unconnected = mask_file(&harness.ctx(), &Inputs::default(), &item("a.jpg", "ZL")).unwrap();
        assert_eq!(unconnected, None);
    }

    #[test]
    fn a_mask_of_another_size_or_no_picture_is_an_error_with_its_name() {
        let harness = Harness::default();
        let inputs = beside(&harness, &[("masks/a.png", 5, GREY)]);
        let error = mask_file(&harness.ctx(), &inputs, &item("a.jpg", ""))
            .unwrap_err()
            .to_string();
        assert_eq!(error, "`masks/a.png` has 5 x 3 pixels, its photo `a.jpg` 4 x 3");
        let text = harness.put(b"hello");
        let list = BTreeMap::from([("masks/a.png".to_owned(), text)]);
        let list = harness.put(&serde_json::to_vec(&list).unwrap());
        let inputs = Inputs(BTreeMap::from([(COMPANIONS.to_owned(), list)]));
        let error = mask_file(&harness.ctx(), &inputs, &item("a.jpg", ""))
            .unwrap_err()
            .to_string();
        assert!(error.starts_with("the mask `masks/a.png`: not a JPEG"), "{error}");
    }
}
