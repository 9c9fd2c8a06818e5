use marf_cache::{
    Digest,
    manifest::{Leaf, Root, Row},
};
use marf_scene::{Camera, Photo, PhotoFacts, encode_png};
use marf_stage::{Ctx, Inputs, PHOTOS, StageError};

/// A photo of the input set.
pub(crate) struct Item {
    pub id: String,
    pub image: Digest,
    pub labelled: bool,
    pub facts: PhotoFacts,
}

/// A photo that got a camera, before it is known which ones are held out.
pub(crate) struct Placed {
    /// Index in the input set.
    pub item: usize,
    /// File name for people and exports: another extension if the photo was encoded anew.
    pub file: String,
    pub image: Digest,
    pub camera: Camera,
    pub cam_from_world: marf_scene::Pose,
    /// What the import says of training and measuring, if it does.
    pub held_out: Option<HeldOut>,
    pub found: Found,
}

/// What the method knows of how well a photo is placed.
#[derive(Debug, Clone, Default)]
pub(crate) struct Found {
    pub features: Option<u32>,
    pub matches: Option<u32>,
    pub inliers: Option<u32>,
    pub error_px: Option<f64>,
    pub error_working_px: Option<f64>,
    pub deviation: Option<crate::mapper::Deviation>,
    /// What is worth knowing of its label.
    pub note: Option<String>,
}

/// Whether a photo is for measuring.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum HeldOut {
    Yes,
    No,
}

/// What a method answers.
pub(crate) struct Calibrated {
    pub placed: Vec<Placed>,
    /// Index in the input set, and why.
    pub unplaced: Vec<(usize, String)>,
    /// Files that have a camera but are not in the input set.
    pub missing: Vec<crate::Missing>,
    pub points: Vec<marf_scene::Point>,
    /// Points with their sights, if the method has them; a sight's frame is the index in the input set.
    pub tracks: Vec<crate::export::TrackPoint>,
    pub up: Option<[f64; 3]>,
    pub metres_per_unit: Option<f64>,
    pub method: String,
    /// What was found in each photo of the input set, placed or not; empty if the method does not tell.
    pub seen: Vec<Found>,
    /// Groups the photos fall into that nothing links, if the method tells.
    pub components: Option<usize>,
    /// Why most of the others were not placed, if the method can tell better than the commonest reason.
    pub cause: Option<String>,
    /// What to try if too few photos were placed.
    pub hint: String,
}

/// Reads the whole input set, in order of shard and id.
pub(crate) fn load(ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<Item>, StageError> {
    let broken = |error: &dyn std::fmt::Display| StageError::new(format!("the set of photos: {error}"));
    let root = Root::decode(&ctx.get(inputs.required(PHOTOS)?)?).map_err(|error| broken(&error))?;
    let mut items = Vec::new();
    for leaf in &root.leaves {
        let leaf = Leaf::decode(&ctx.get(&leaf.leaf)?).map_err(|error| broken(&error))?;
        for row in leaf.rows {
            items.push(item(row)?);
        }
    }
    if items.is_empty() {
        return Err(
            StageError::new("the set of photos is empty: there is nothing to calibrate").hint(
                "the verdicts of the nodes before it tell why each photo was left out; `marf filter DIR` lists them",
            ),
        );
    }
    Ok(items)
}

fn item(row: Row) -> Result<Item, StageError> {
    let facts = PhotoFacts::from_json(&row.facts)
        .map_err(|error| StageError::new(format!("photo `{}`: its facts cannot be read: {error}", row.id)))?;
    let image = row
        .blobs
        .get("image")
        .ok_or_else(|| StageError::new(format!("photo `{}` has no image", row.id)))?;
    Ok(Item {
        image: *image,
        labelled: row.blobs.contains_key("label"),
        facts,
        id: row.id,
    })
}

/// Reads and decodes a photo of the set.
pub(crate) fn decode(ctx: &Ctx<'_>, item: &Item) -> Result<Photo, StageError> {
    let bytes = ctx.get(&item.image)?;
    Photo::decode_validated(&bytes).map_err(|error| StageError::new(format!("photo `{}`: {error}", item.id)))
}

/// The whole factor that brings the longer side to at most `longest_side_px`.
pub(crate) fn reduction(width: u32, height: u32, longest_side_px: Option<u32>) -> u32 {
    longest_side_px.map_or(1, |side| width.max(height).div_ceil(side.max(1)).max(1))
}

/// Stores an image made here as PNG.
pub(crate) fn store(
    ctx: &Ctx<'_>,
    item: &Item,
    image: &marf_scene::Image<marf_scene::Srgb>,
) -> Result<Digest, StageError> {
    let bytes =
        encode_png(image).map_err(|error| StageError::new(format!("photo `{}`: {error}", item.id)))?;
    ctx.put(&bytes)
}

/// The file's name with the extension of what [`store`] writes.
pub(crate) fn as_png(file: &str) -> String {
    format!("{}.png", without_extension(file))
}

/// The file's name up to the last dot of its last part; a leading dot is part of the name.
pub(crate) fn without_extension(file: &str) -> &str {
    let base = file.rfind('/').map_or(0, |slash| slash + 1);
    match file[base..].rfind('.') {
        Some(dot) if dot > 0 => &file[..base + dot],
        _ => file,
    }
}
