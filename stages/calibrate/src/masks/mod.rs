//! Mask proposals (`masks`) for parts that stand still in the pictures of a camera that moves.

pub(crate) mod stationary;

use std::collections::BTreeMap;

use marf_cache::Digest;
use marf_scene::{Image, Srgb, encode_png};
use marf_schema::masks::{CameraReport, MasksParams, Metrics};
use marf_schema::output::{MASKS, OVERLAY};
use marf_stage::{COMPANIONS, Ctx, Document, Inputs, Outputs, PHOTOS, Port, Set, StageError, Threads, stage};
use rayon::prelude::*;

use crate::mask_files::{HIDDEN, OPEN, shrunk, undistorted_mask};
use crate::mask_names::camera_name;
use crate::photos::{InputPhoto, decode, load, reduction};
use stationary::{Gray, LEAST_PAIRS, StationaryParts, grown_by};

/// Longest side of the pictures that are compared, pixels.
const COMPARED_PX: u32 = 160;
/// Longest side of the picture that shows a proposal, pixels.
const OVERLAY_PX: u32 = 640;
/// Pixels of the compared pictures by which a proposal is widened: windows over its rim hold ground, too.
const MARGIN: usize = 1;

/// Finds the parts that stand still in the pictures of each camera, and proposes masks of them.
///
/// - In: the photos, and the files next to them, whose masks show what is already hidden.
/// - Out: `masks/<camera>.png` (black where the picture stands still), `overlay/<camera>.png` (a photo with that in red) and `metrics`. This
///   hides nothing. A user who agrees puts the mask next to the photos, where `calibrate` finds it.
/// - Cost: at most `photos` photos of a camera are decoded, and compared at 160 pixels.
/// - Bad input: a photo that cannot be decoded stops the node.
pub struct Masks(MasksParams);

stage! {
    Masks { 0: MasksParams },
    Set,
    Threads::All,
    about: "proposes masks for what stands still while the camera moves",
    version: 1,
    ports: [
        Port::required("input", PHOTOS),
        Port::optional("cameras", COMPANIONS),
    ],
    outputs: [Metrics::OUTPUT, MASKS, OVERLAY],
}

impl Set for Masks {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let mut by_camera: BTreeMap<String, Vec<InputPhoto>> = BTreeMap::new();
        for item in load(ctx, inputs)? {
            by_camera.entry(camera_name(&item.facts)).or_default().push(item);
        }
        let (mut outputs, mut cameras) = (Outputs::new(), Vec::new());
        let total = by_camera.len() as u64;
        for (done, (name, items)) in (0..).zip(by_camera) {
            ctx.progress
                .at(done, total, &format!("comparing photos of {name}"));
            let camera = Camera::read(ctx, inputs, name, &items, self.0.photos)?;
            let found = StationaryParts::find(&camera.photos, &camera.known);
            let report = camera.report(&found);
            if report.share > 0.0 {
                camera.propose(ctx, &found, &mut outputs)?;
            }
            cameras.push(report);
        }
        let metrics = Metrics { cameras };
        let bytes = metrics
            .encode()
            .map_err(|error| StageError::new(error.to_string()))?;
        outputs.insert(Metrics::OUTPUT.to_owned(), ctx.put(&bytes)?);
        Ok(outputs)
    }
}

/// The photos of one camera that are compared.
struct Camera {
    name: String,
    /// Size of its photos, and how many there are.
    size_px: [u32; 2],
    count: usize,
    /// Factor by which photos are shrunk to be compared.
    factor: u32,
    photos: Vec<Gray>,
    /// Pixels that the masks next to the photos hide in all of them.
    known: Vec<bool>,
    /// A photo of about the middle of the set, to show a proposal on.
    shown: Image<Srgb>,
}

impl Camera {
    fn read(
        ctx: &Ctx<'_>,
        inputs: &Inputs,
        name: String,
        items: &[InputPhoto],
        most: u32,
    ) -> Result<Self, StageError> {
        let size_px = items
            .first()
            .map_or([0; 2], |item| [item.facts.width, item.facts.height]);
        let factor = reduction(size_px[0], size_px[1], Some(COMPARED_PX));
        let wanted = items.len().min(most as usize);
        let chosen = |index: usize| &items[(2 * index + 1) * items.len() / (2 * wanted)];
        let read = |index: usize| -> Result<(Gray, Vec<bool>), StageError> {
            ctx.check()?;
            let small = decode(ctx, chosen(index))?.image.box_reduced(factor);
            let hidden = match undistorted_mask(ctx, inputs, chosen(index), None)? {
                Some(mask) => shrunk(&mask, factor)
                    .pixels
                    .iter()
                    .map(|pixel| *pixel == HIDDEN)
                    .collect(),
                None => vec![false; small.pixels.len()],
            };
            Ok((gray(&small), hidden))
        };
        let all: Vec<_> = (0..wanted).into_par_iter().map(read).collect::<Result<_, _>>()?;
        let known = |pixel: usize| all.iter().all(|(_, hidden)| hidden[pixel]);
        let pixels = all.first().map_or(0, |(_, hidden)| hidden.len());
        Ok(Self {
            name,
            size_px,
            count: items.len(),
            factor,
            known: (0..pixels).map(known).collect(),
            photos: all.into_iter().map(|(photo, _)| photo).collect(),
            shown: decode(ctx, chosen(wanted / 2))?.image,
        })
    }

    fn report(&self, found: &StationaryParts) -> CameraReport {
        let count = found.is_stationary.iter().filter(|is_in| **is_in).count();
        let share = count as f64 / found.is_stationary.len().max(1) as f64;
        CameraReport {
            found: match (found.moved, share > 0.0) {
                (_, true) => format!(
                    "{:.1} % of the picture stands still while the camera moves",
                    share * 100.0
                ),
                (LEAST_PAIRS.., false) => "nothing stands still".to_owned(),
                (moved, false) => format!(
                    "the camera moves in {moved} of {} pairs of photos, which says nothing: at least {} are needed",
                    found.pairs, LEAST_PAIRS
                ),
            },
            name: self.name.clone(),
            width: self.size_px[0],
            height: self.size_px[1],
            photos: self.count as u64,
            pairs: found.pairs,
            moved: found.moved,
            share,
        }
    }

    /// Stores a proposal: the mask in the size of the photos, and a photo that shows it.
    fn propose(
        &self,
        ctx: &Ctx<'_>,
        found: &StationaryParts,
        outputs: &mut Outputs,
    ) -> Result<(), StageError> {
        let width = self.photos.first().map_or(0, |photo| photo.width);
        let hidden = grown_by(&found.is_stationary, width, MARGIN);
        let height = hidden.len() / width.max(1);
        let is_hidden = |column: u32, row: u32| {
            // Columns and rows that fill no box are those of the last one.
            let column = ((column / self.factor) as usize).min(width.saturating_sub(1));
            let row = ((row / self.factor) as usize).min(height.saturating_sub(1));
            hidden[row * width + column]
        };
        let [columns, rows] = self.size_px;
        let mask = Image::from_fn(
            columns,
            rows,
            |column, row| if is_hidden(column, row) { HIDDEN } else { OPEN },
        );
        let factor = reduction(columns, rows, Some(OVERLAY_PX));
        let small = self.shown.box_reduced(factor);
        let overlay = Image::from_fn(small.width, small.height, |column, row| {
            let [red, green, blue] = small.at(column, row);
            if is_hidden(column * factor, row * factor) {
                [128 + red / 2, green / 2, blue / 2]
            } else {
                [red, green, blue]
            }
        });
        for (folder, picture) in [(MASKS, mask), (OVERLAY, overlay)] {
            let png = encode_png(&picture).map_err(|error| StageError::new(error.to_string()))?;
            let digest: Digest = ctx.put(&png)?;
            outputs.insert(format!("{folder}{}.png", self.name), digest);
        }
        Ok(())
    }
}

/// Returns the luma of a picture (Rec. 601), 0 to 255.
pub(crate) fn gray(image: &Image<Srgb>) -> Gray {
    let luma = |[red, green, blue]: &[u8; 3]| {
        f64::from(u32::from(*red) * 299 + u32::from(*green) * 587 + u32::from(*blue) * 114) / 1000.0
    };
    Gray {
        width: image.width as usize,
        values: image.pixels.iter().map(luma).collect(),
    }
}
