//! The photos of the input set: reading, decoding, storing.

use marf_cache::{Digest, digest_of, manifest::Row};
use marf_scene::{Image, Photo, PhotoFacts, Srgb};
use marf_stage::{Ctx, Inputs, PHOTOS, StageError, rows_of};

use crate::orientation::Orientation;

/// A photo of the input set.
#[derive(Clone)]
pub(crate) struct InputPhoto {
    pub id: String,
    pub image: Digest,
    pub labelled: bool,
    /// Whether the image was made of the file: developed from raw numbers or from a mosaic.
    pub developed: bool,
    /// Its mask in the grid of the image, where the import names one or has made one.
    pub mask: Option<Digest>,
    pub facts: PhotoFacts,
}

impl InputPhoto {
    /// Returns a photo that is its file, without label.
    pub fn new(id: String, image: Digest, facts: PhotoFacts) -> Self {
        Self {
            id,
            image,
            labelled: false,
            developed: false,
            mask: None,
            facts,
        }
    }

    /// Returns how the file's pixels are turned to be upright.
    pub fn orientation(&self) -> Orientation {
        Orientation::from_notes(&self.facts.notes)
    }

    /// Returns width and height of the pixels as the file has them, whatever its EXIF orientation.
    pub fn stored_size_px(&self) -> (u32, u32) {
        let [width, height] = self
            .orientation()
            .other_size([self.facts.width, self.facts.height]);
        (width, height)
    }
}

/// Returns the photos of the input set, in order of shard and id.
pub(crate) fn load(ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<InputPhoto>, StageError> {
    let rows = rows(ctx, inputs)?;
    rows.into_iter().map(|(_, row)| item(row)).collect()
}

/// Returns the rows of the input set, each with its shard, in order of shard and id.
pub(crate) fn rows(ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<(u32, Row)>, StageError> {
    let rows = rows_of(ctx, inputs.required(PHOTOS)?)?;
    if rows.is_empty() {
        return Err(
            StageError::new("the set of photos is empty: there is nothing to calibrate").hint(
                "the verdicts of the nodes before it say why each photo was left out: `marf filter DIR` lists them",
            ),
        );
    }
    Ok(rows)
}

/// Returns the photo of a row.
pub(crate) fn item(row: Row) -> Result<InputPhoto, StageError> {
    let facts = PhotoFacts::from_json(&row.facts)
        .map_err(|error| StageError::new(format!("photo `{}`: its facts cannot be read: {error}", row.id)))?;
    let image = row
        .blobs
        .get("image")
        .ok_or_else(|| StageError::new(format!("photo `{}` has no image", row.id)))?;
    Ok(InputPhoto {
        labelled: row.blobs.contains_key("label"),
        developed: row.blobs.contains_key("raw"),
        ..InputPhoto::new(row.id, *image, facts)
    })
}

/// Returns a decoded photo of the set.
pub(crate) fn decode(ctx: &Ctx<'_>, item: &InputPhoto) -> Result<Photo, StageError> {
    let bytes = ctx.get(&item.image)?;
    Photo::decode_validated(&bytes).map_err(|error| StageError::new(format!("photo `{}`: {error}", item.id)))
}

/// Returns the size of a photo upright, from its facts or, if they lack it, from its pixels.
pub(crate) fn size_px(ctx: &Ctx<'_>, item: &InputPhoto) -> Result<[u32; 2], StageError> {
    match [item.facts.width, item.facts.height] {
        [0, _] | [_, 0] => {
            let photo = decode(ctx, item)?.image;
            Ok([photo.width, photo.height])
        }
        size => Ok(size),
    }
}

/// Returns the integer factor that reduces the longer side to at most `longest_side_px`.
pub(crate) fn reduction(width: u32, height: u32, longest_side_px: Option<u32>) -> u32 {
    longest_side_px.map_or(1, |side| width.max(height).div_ceil(side.max(1)).max(1))
}

/// Returns a photo whose colours and opacities are both in the pixel grid that `change` gives them.
pub(crate) fn with_other_grid<E>(
    photo: Photo,
    change: impl Fn(&Image<Srgb>) -> Result<Image<Srgb>, E>,
) -> Result<Photo, E> {
    let alpha = if photo.alpha.is_empty() {
        Vec::new()
    } else {
        let opacity = |alpha: &u8| [*alpha; 3];
        let opacities = Image {
            pixels: photo.alpha.iter().map(opacity).collect(),
            ..photo.image
        };
        change(&opacities)?.pixels.iter().map(|pixel| pixel[0]).collect()
    };
    Ok(Photo {
        image: change(&photo.image)?,
        alpha,
        ..photo
    })
}

/// Stores a photo as PNG and returns its digest.
pub(crate) fn store(ctx: &Ctx<'_>, item: &InputPhoto, photo: &Photo) -> Result<Digest, StageError> {
    let png = photo.to_png();
    ctx.put(&png.map_err(|error| StageError::new(format!("photo `{}`: {error}", item.id)))?)
}

/// Returns the digest of a photo reduced by an integer factor, as PNG. The result of an earlier run is taken from the memo.
///
/// # Errors
/// A photo that cannot be decoded, or is not of that width and height.
pub(crate) fn reduced(
    ctx: &Ctx<'_>,
    id: &str,
    image: &Digest,
    size_px: [u32; 2],
    factor: u32,
) -> Result<Digest, StageError> {
    ctx.check()?;
    let key = digest_of(&("calibrate reduced photo 2", *image, (size_px, factor)));
    let known = ctx.memos.load(&key).and_then(|bytes| {
        let digest = Digest::from_bytes((*bytes).try_into().ok()?);
        kept(ctx, &digest).then_some(digest)
    });
    if let Some(known) = known {
        return Ok(known);
    }
    let broken = |error: &dyn std::fmt::Display| StageError::new(format!("photo `{id}`: {error}"));
    let photo = Photo::decode_validated(&ctx.get(image)?).map_err(|error| broken(&error))?;
    let (width, height) = (photo.image.width, photo.image.height);
    if [width, height] != size_px {
        return Err(StageError::new(format!(
            "photo `{id}` has {width} x {height} pixels upright, its facts say {} x {}",
            size_px[0], size_px[1]
        )));
    }
    let png = photo
        .box_reduced(factor)
        .to_png()
        .map_err(|error| broken(&error))?;
    let digest = ctx.put(&png)?;
    ctx.memos.save(&key, digest.as_bytes());
    Ok(digest)
}

/// Returns whether an image of an earlier run is still stored, and stores it for this run.
pub(crate) fn kept(ctx: &Ctx<'_>, image: &Digest) -> bool {
    ctx.get(image).and_then(|bytes| ctx.put(&bytes)).is_ok()
}

/// Returns the file's name with the extension `.png`.
pub(crate) fn as_png(file: &str) -> String {
    format!("{}.png", without_extension(file))
}

/// Returns the file's name without extension. A leading dot is part of the name.
pub(crate) fn without_extension(file: &str) -> &str {
    let base = file.rfind('/').map_or(0, |slash| slash + 1);
    match file[base..].rfind('.') {
        Some(dot) if dot > 0 => &file[..base + dot],
        _ => file,
    }
}
