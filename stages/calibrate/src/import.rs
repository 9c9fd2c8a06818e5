//! Cameras and points that another program found: transforms.json of instant-ngp and nerfstudio with its PLY,
//! models of COLMAP.

mod cameras;
mod choose;
mod colmap;
mod distortion;
mod json_node;
mod lens;
mod matching;
mod paths;
mod photo_names;
mod pose_matrix;
mod ready;
mod transforms;
mod undistort;

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::Digest;
use marf_scene::ply::read_points;
use marf_stage::{COMPANIONS, Ctx, Inputs, StageError};
use rayon::prelude::*;

use cameras::refused;
pub use cameras::{Cameras, ImportError, Role, View};
pub use colmap::{Model, read_colmap_binary, read_colmap_text, read_tracks};
pub use distortion::{Distortion, Rational};
pub use lens::{Focal, Lens};
pub use transforms::{Transforms, names_in_transforms, read_transforms};
pub(crate) use undistort::Undistorter;

use crate::calibration::{Calibration, HeldOut, PlacedPhoto, up_of};
use crate::export::TrackPoint;
use crate::photos::InputPhoto;
use crate::sfm;
use choose::{Source, candidates, choose};
use marf_schema::calibrate::CalibrateParams;
use marf_schema::calibrate::Missing;
use matching::{MatchedViews, match_views};
use photo_names::composed;
use ready::{ReadyPhoto, placed, ready};
use transforms::POINTS_KEY;

/// Returns the cameras of the chosen file for the photos, in the world of the file.
///
/// Its unit may not be metres, so `metres_per_unit` stays empty. Up is found from the cameras and the ground. Cameras are
/// for the pixels as they are stored, whatever a photo's EXIF orientation.
pub(crate) fn run(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    items: &[InputPhoto],
    params: &CalibrateParams,
) -> Result<Calibration, StageError> {
    let files = companions(ctx, inputs)?;
    let chosen = choose(&files, params.file.as_deref())?;
    let (source, name) = (chosen.source, chosen.source_name);
    let cameras = read(ctx, &files, &source)?;
    let mut matched = match_views(&name, &cameras.views, items);
    matched.missing.extend(cameras.rejected);
    let masks = named_masks(&files, items, &mut matched);
    let done = matched.pairs.par_iter().map(|(index, view)| {
        ctx.check()?;
        let item = InputPhoto {
            mask: masks.get(index).copied(),
            ..items[*index].clone()
        };
        let photo = ready(ctx, inputs, &name, view, &item)?;
        let placed = placed(ctx, *index, view, &photo, params)?;
        Ok(ImportedPhoto { ready: photo, placed })
    });
    let mut imported = done.collect::<Result<Vec<ImportedPhoto>, StageError>>()?;
    let (mut points, mut tracks) = (cameras.points, Vec::new());
    let mut method = format!("import of {name}");
    for choice in [chosen.choice, matched.choice].into_iter().flatten() {
        method += &format!("; {choice}");
    }
    if points.is_empty() && params.find_points {
        tracks = find_points(ctx, inputs, &mut imported, params)?;
        points = tracks.iter().map(sfm::sparse).collect();
        method += &format!(", {} points found in the photos", points.len());
    }
    let placed: Vec<PlacedPhoto> = imported.into_iter().map(|one| one.placed).collect();
    Ok(Calibration {
        up: up_of(&placed, &points),
        placed,
        unplaced: matched.unplaced,
        missing: matched.missing,
        points,
        tracks,
        method,
        hint: format!("check that {name} has the names of the photos next to it"),
        ..Calibration::default()
    })
}

/// A photo with its camera, before and after it is reduced.
struct ImportedPhoto {
    ready: ReadyPhoto,
    placed: PlacedPhoto,
}

/// Returns the masks that the file names, by photo. A file that is not there is added to `missing`.
fn named_masks(
    files: &BTreeMap<String, Digest>,
    items: &[InputPhoto],
    matched: &mut MatchedViews<'_>,
) -> BTreeMap<usize, Digest> {
    let mut masks = BTreeMap::new();
    for (index, view) in &matched.pairs {
        let Some(name) = &view.mask else {
            continue;
        };
        let Some(mask) = named_file(files, items, name) else {
            matched.missing.push(Missing {
                file: name.clone(),
                reason: format!(
                    "the mask of {} is not among the files next to the photos",
                    view.file
                ),
            });
            continue;
        };
        masks.insert(*index, mask);
    }
    masks
}

/// Returns the file of this name, or the only one whose path is the tail of it. Photos are searched as well, since a mask may have been
/// read as one.
fn named_file(files: &BTreeMap<String, Digest>, items: &[InputPhoto], name: &str) -> Option<Digest> {
    let wanted = composed(name);
    let fits = |file: &str| {
        let file = composed(file);
        file == wanted || (name.starts_with('/') && wanted.ends_with(&format!("/{file}")))
    };
    let named = files
        .iter()
        .filter(|(file, _)| fits(file))
        .map(|(_, digest)| *digest);
    let photos = items
        .iter()
        .filter(|item| fits(&item.facts.file))
        .map(|item| item.image);
    let mut found = named.chain(photos);
    let first = found.next()?;
    found.all(|other| other == first).then_some(first)
}

/// Returns the points that the photos to train on show, and sets the statistics of each photo: how far points are from where it shows them.
///
/// A photo that the file holds out adds no point, since it judges a field that must not depend on it.
fn find_points(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    imported: &mut [ImportedPhoto],
    params: &CalibrateParams,
) -> Result<Vec<TrackPoint>, StageError> {
    let mut open: Vec<&mut ImportedPhoto> = imported
        .iter_mut()
        .filter(|one| one.placed.held_out != Some(HeldOut::Yes))
        .collect();
    let photos: Vec<InputPhoto> = open.iter().map(|one| one.ready.item.clone()).collect();
    let cameras: Vec<&PlacedPhoto> = open.iter().map(|one| &one.placed).collect();
    let found = sfm::points_of_known(ctx, inputs, &photos, &cameras, params)?;
    let mut tracks = found.tracks;
    for observation in tracks.iter_mut().flat_map(|track| &mut track.observations) {
        observation.frame = open[observation.frame as usize].placed.item as u32;
    }
    for (one, statistics) in open.iter_mut().zip(found.statistics) {
        one.placed.statistics = statistics;
    }
    Ok(tracks)
}

/// Returns whether one of the files next to photos, as `extract` lists them, may hold their cameras.
pub fn names_cameras(companions: &[u8]) -> bool {
    serde_json::from_slice(companions).is_ok_and(|files| !candidates(&files).is_empty())
}

/// Returns whether a file next to the photos may hold their cameras.
pub(crate) fn has_cameras(ctx: &Ctx<'_>, inputs: &Inputs) -> Result<bool, StageError> {
    match inputs.optional(COMPANIONS) {
        Some(_) => Ok(!candidates(&companions(ctx, inputs)?).is_empty()),
        None => Ok(false),
    }
}

/// Returns the files next to the photos.
fn companions(ctx: &Ctx<'_>, inputs: &Inputs) -> Result<BTreeMap<String, Digest>, StageError> {
    let digest = inputs.optional(COMPANIONS).ok_or_else(|| {
        StageError::new(
            "method = \"import\" needs the files next to the photos, and `cameras` is not connected",
        )
        .hint("set `cameras` of this node to the extract node")
    })?;
    serde_json::from_slice(&ctx.get(digest)?)
        .map_err(|error| StageError::new(format!("the list of files next to the photos: {error}")))
}

/// Returns the cameras and points of the chosen file.
fn read(ctx: &Ctx<'_>, files: &BTreeMap<String, Digest>, source: &Source) -> Result<Cameras, StageError> {
    let get = |name: &str| match files.get(name) {
        Some(digest) => ctx.get(digest),
        None => Err(StageError::new(format!(
            "`{name}` is not among the files next to the photos"
        ))),
    };
    let optional = |name: &String| files.get(name).map(|digest| ctx.get(digest)).transpose();
    match source {
        Source::Transforms(names) => {
            let mut cameras = Cameras::default();
            let mut clouds = BTreeSet::new();
            for (name, role) in names {
                let read = read_transforms(name, &get(name)?).map_err(refused)?;
                cameras.rejected.extend(read.rejected);
                cameras.views.extend(read.views.into_iter().map(|view| View {
                    role: if view.role == Role::Open { *role } else { view.role },
                    ..view
                }));
                // The parts of a split set may name the same points.
                let cloud = read.points.filter(|cloud| clouds.insert(cloud.clone()));
                if let Some(cloud) = cloud {
                    let digest = named_file(files, &[], &cloud).ok_or_else(|| no_points(name, &cloud))?;
                    let bytes = ctx.get(&digest)?;
                    let points = read_points(&bytes)
                        .map_err(|error| ImportError::new(&cloud, error.place, error.problem))
                        .map_err(refused)?;
                    cameras.points.extend(points);
                }
            }
            Ok(cameras)
        }
        Source::Binary(names) | Source::Text(names) => {
            let (cameras, images, points) = (get(&names[0])?, get(&names[1])?, optional(&names[2])?);
            let model = Model {
                names: names.each_ref().map(String::as_str),
                cameras: &cameras,
                images: &images,
                points: points.as_deref(),
            };
            let read = match source {
                Source::Binary(_) => read_colmap_binary(&model),
                _ => read_colmap_text(&model),
            };
            read.map_err(refused)
        }
    }
}

/// Returns the error of a missing file of points.
fn no_points(file: &str, points: &str) -> StageError {
    let problem = format!(
        "`{points}` is not among the files next to the photos. Points are found as `points.ply` or \
         `sparse_pc.ply` at the top, in sparse/ or in sparse/0/"
    );
    let error = ImportError::new(file, format!("/{POINTS_KEY}"), problem);
    StageError::new(error.to_string()).hint(format!(
        "put the points there, or take `{POINTS_KEY}` out of {file} to go without them"
    ))
}
