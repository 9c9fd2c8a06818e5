//! Cameras from an installed COLMAP, by explicit choice.
//!
//! The only method that runs another program: its result is COLMAP's, not reproducible to the byte, and kept under the
//! node's key like any other result. The version of COLMAP is named in the scene.

mod program;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use marf_cache::file::{FileKind, Links, read};
use marf_scene::encode_png;
use marf_schema::calibrate::CalibrateParams;
use marf_stage::{Ctx, Inputs, StageError};
use rayon::prelude::*;

use crate::calibration::{Calibration, PlacedPhoto, up_of};
use crate::import::{self, Model, read_colmap_binary};
use crate::mask_files::mask_file;
use crate::orientation::Orientation;
use crate::photos::{InputPhoto, decode, size_px};
use program::{Program, cannot_write};

/// Up to this many photos every pair is matched. In larger sets each photo is matched with its neighbours by file name.
const EXHAUSTIVE: usize = 60;
/// Names of the model's files, for messages and on the disk.
const FILES: [&str; 3] = ["cameras.bin", "images.bin", "points3D.bin"];

/// Returns the cameras of the largest of COLMAP's models.
///
/// Photos of one instrument, device and size share a camera of the model OPENCV. Masks are passed on. Features and matches are found on the
/// CPU. The world is COLMAP's own, without scale. Up is the mean of the cameras'.
///
/// # Errors
/// No such program, a step that fails (with its last lines), no model.
pub(crate) fn run(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    items: &[InputPhoto],
    params: &CalibrateParams,
) -> Result<Calibration, StageError> {
    let folder = tempfile::tempdir().map_err(|error| cannot_write("a temporary folder", &error))?;
    let program = Program::find(ctx, params.colmap.as_deref().unwrap_or("colmap"), folder.path())?;
    let names = write_inputs(ctx, inputs, items, folder.path())?;
    let matcher = match items.len() {
        0..=EXHAUSTIVE => "exhaustive_matcher",
        _ => "sequential_matcher",
    };
    program.extract_features(ctx)?;
    program.find_matches(ctx, matcher)?;
    program.map(ctx)?;
    let models = models(&folder.path().join("models"))?;
    let Some(files) = models.first() else {
        return Err(StageError::new("colmap placed no photo").hint(
            "photos of one scene must overlap by half (`method = \"sfm\"` reports which photos match)",
        ));
    };
    let model = Model {
        names: FILES,
        cameras: &files[0],
        images: &files[1],
        points: Some(&files[2]),
    };
    let cameras = read_colmap_binary(&model).map_err(|error| StageError::new(error.to_string()))?;
    let views: Vec<_> = cameras
        .views
        .iter()
        .filter_map(|view| Some((*names.get(&view.file)?, view)))
        .collect();
    let placed = views
        .par_iter()
        .map(|(item, view)| {
            let upright_px = size_px(ctx, &items[*item])?;
            let ready = import::as_it_is(FILES[1], view, &items[*item], upright_px)?;
            import::placed(ctx, *item, view, &ready, params)
        })
        .collect::<Result<Vec<PlacedPhoto>, StageError>>()?;
    let found: BTreeSet<usize> = placed.iter().map(|one| one.item).collect();
    let absent = (0..items.len()).filter(|item| !found.contains(item));
    let reason = format!("not in the largest of colmap's models, of {}", models.len());
    Ok(Calibration {
        unplaced: absent.map(|item| (item, reason.clone())).collect(),
        up: up_of(&placed, &cameras.points),
        placed,
        points: cameras.points,
        method: format!("{}: OPENCV cameras, {matcher}, largest model", program.version),
        hint: "take photos that overlap by half, or try `method = \"sfm\"`".to_owned(),
        ..Calibration::default()
    })
}

/// Writes photos and masks as COLMAP reads them and returns the item of each name.
///
/// Photos that share a camera share a folder. Names sort as the files do, because neighbours are matched.
fn write_inputs(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    items: &[InputPhoto],
    folder: &Path,
) -> Result<BTreeMap<String, usize>, StageError> {
    let camera = |item: &InputPhoto| {
        let facts = item.facts.clone();
        (facts.instrument, facts.device, facts.width, facts.height)
    };
    let cameras: BTreeSet<_> = items.iter().map(camera).collect();
    let mut order: Vec<usize> = (0..items.len()).collect();
    order.sort_by(|a, b| (&items[*a].facts.file, *a).cmp(&(&items[*b].facts.file, *b)));
    let mut names = BTreeMap::new();
    for (rank, item) in order.into_iter().enumerate() {
        ctx.check()?;
        let subfolder = cameras.iter().position(|one| *one == camera(&items[item]));
        let (bytes, end) = upright(ctx, &items[item])?;
        let name = format!("{:03}/{rank:05}.{end}", subfolder.unwrap_or_default());
        write(&folder.join("images").join(&name), &bytes)?;
        if let Some(mask) = mask_file(ctx, inputs, &items[item])? {
            let mask = encode_png(&mask).map_err(|error| StageError::new(error.to_string()))?;
            write(&folder.join("masks").join(format!("{name}.png")), &mask)?;
        }
        names.insert(name, item);
    }
    Ok(names)
}

/// Returns the photo's own bytes if COLMAP decodes them as we do: it reads JPEG and PNG, and ignores the orientation.
fn upright(ctx: &Ctx<'_>, item: &InputPhoto) -> Result<(Vec<u8>, &'static str), StageError> {
    let bytes = ctx.get(&item.image)?;
    let turned = item.orientation() != Orientation::UPRIGHT;
    match bytes.get(..4) {
        Some([0xff, 0xd8, ..]) if !turned => Ok((bytes.to_vec(), "jpg")),
        Some(b"\x89PNG") if !turned => Ok((bytes.to_vec(), "png")),
        _ => {
            let png = encode_png(&decode(ctx, item)?.image);
            Ok((png.map_err(|error| StageError::new(error.to_string()))?, "png"))
        }
    }
}

/// Writes a file and its folders.
fn write(path: &Path, bytes: &[u8]) -> Result<(), StageError> {
    let folder = path.parent().map_or(Ok(()), std::fs::create_dir_all);
    folder
        .and_then(|()| std::fs::write(path, bytes))
        .map_err(|error| cannot_write("a photo", &error))
}

/// Returns all models, the one with most photos first, then by number.
fn models(folder: &Path) -> Result<Vec<[Vec<u8>; 3]>, StageError> {
    let mut models = Vec::new();
    for number in 0.. {
        let model = folder.join(number.to_string());
        if !model.is_dir() {
            break;
        }
        let bytes = |file: &str| {
            let fail = |error| StageError::new(format!("colmap's {file} cannot be read: {error}"));
            read(&model.join(file), FileKind::State, Links::Followed).map_err(fail)
        };
        models.push([bytes(FILES[0])?, bytes(FILES[1])?, bytes(FILES[2])?]);
    }
    // The file of images begins with their number.
    let photos = |files: &[Vec<u8>; 3]| {
        files[1]
            .first_chunk()
            .map_or(0, |count| u64::from_le_bytes(*count))
    };
    models.sort_by_key(|files| std::cmp::Reverse(photos(files)));
    Ok(models)
}
