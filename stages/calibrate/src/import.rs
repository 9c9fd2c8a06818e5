//! Cameras and points that another program found: transforms.json of instant-ngp and nerfstudio with its PLY,
//! models of COLMAP.

mod cameras;
mod choose;
mod colmap;
mod json_node;
mod lens;
mod photo_names;
mod transforms;

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::Digest;
use marf_scene::{Camera, ply::read_points};
use marf_stage::{COMPANIONS, Ctx, Inputs, StageError};
use rayon::prelude::*;

pub use cameras::{Cameras, ImportError, Role, View};
pub use colmap::{Model, read_colmap_binary, read_colmap_text, read_tracks};
pub use lens::{Focal, Lens};
pub use transforms::{Transforms, read_transforms};

use crate::calibration::{Calibration, HeldOut, PhotoStatistics, PlacedPhoto, mean_up};
use crate::export::TrackPoint;
use crate::photos::{InputPhoto, as_png, decode, reduced, reduction};
use crate::sfm;
use choose::{Source, candidates, choose};
use marf_schema::calibrate::CalibrateParams;
use marf_schema::calibrate::Missing;
use photo_names::PhotoNames;
use transforms::POINTS_KEY;

/// Returns the cameras of the chosen file for the photos; the world is that of the file.
///
/// Its unit is not known to be metres, so `metres_per_unit` stays empty; up is the mean of the cameras' up
/// vectors unless they cancel.
pub(crate) fn run(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    items: &[InputPhoto],
    params: &CalibrateParams,
) -> Result<Calibration, StageError> {
    let files = companions(ctx, inputs)?;
    let source = choose(&files, params.file.as_deref())?;
    let cameras = read(ctx, &files, &source)?;
    let matched = match_views(&source, &cameras.views, items).map_err(refused)?;
    let done = matched.pairs.par_iter().map(|(item, view)| {
        ctx.check()?;
        let photo = sized_photo(ctx, &source.name(), view, &items[*item], params)?;
        Ok(placed(*item, view, photo))
    });
    let mut placed = done.collect::<Result<Vec<PlacedPhoto>, StageError>>()?;
    let (mut points, mut tracks) = (cameras.points, Vec::new());
    let mut method = format!("import of {}", source.name());
    if points.is_empty() && params.find_points {
        tracks = find_points(ctx, inputs, items, &mut placed, params)?;
        points = tracks.iter().map(sfm::sparse).collect();
        method += &format!(", {} points found in the photos", points.len());
    }
    Ok(Calibration {
        up: mean_up(&placed),
        placed,
        unplaced: matched.unplaced,
        missing: matched.missing,
        points,
        tracks,
        site: None,
        metres_per_unit: None,
        method,
        components: None,
        statistics: Vec::new(),
        cause: None,
        hint: format!(
            "check that the names in {} are those of the photos beside it",
            source.name()
        ),
    })
}

/// Returns the points that the photos to train on show, and tells of each of these how far points lie from where it shows them.
///
/// A photo that the file holds out adds no point: it is to judge a field that nothing of it has told.
fn find_points(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    items: &[InputPhoto],
    placed: &mut [PlacedPhoto],
    params: &CalibrateParams,
) -> Result<Vec<TrackPoint>, StageError> {
    let mut open: Vec<&mut PlacedPhoto> = placed
        .iter_mut()
        .filter(|one| one.held_out != Some(HeldOut::Yes))
        .collect();
    let photos: Vec<InputPhoto> = open.iter().map(|one| items[one.item].clone()).collect();
    let cameras: Vec<&PlacedPhoto> = open.iter().map(|one| &**one).collect();
    let found = sfm::points_of_known(ctx, inputs, &photos, &cameras, params)?;
    let mut tracks = found.tracks;
    for observation in tracks.iter_mut().flat_map(|track| &mut track.observations) {
        observation.frame = open[observation.frame as usize].item as u32;
    }
    for (one, statistics) in open.iter_mut().zip(found.statistics) {
        one.statistics = statistics;
    }
    Ok(tracks)
}

/// Tells whether a file beside the photos may hold their cameras.
pub(crate) fn has_cameras(ctx: &Ctx<'_>, inputs: &Inputs) -> Result<bool, StageError> {
    match inputs.optional(COMPANIONS) {
        Some(_) => Ok(!candidates(&companions(ctx, inputs)?).is_empty()),
        None => Ok(false),
    }
}

/// Returns the error of a refused camera file.
fn refused(error: ImportError) -> StageError {
    StageError::new(error.to_string())
        .hint("correct the file or write it anew; no camera of it was used".to_owned())
}

/// Returns the files beside the photos.
fn companions(ctx: &Ctx<'_>, inputs: &Inputs) -> Result<BTreeMap<String, Digest>, StageError> {
    let digest = inputs.optional(COMPANIONS).ok_or_else(|| {
        StageError::new(
            "method = \"import\" needs the files beside the photos, and `cameras` is not connected",
        )
        .hint("set `cameras` of this node to the extract node")
    })?;
    serde_json::from_slice(&ctx.get(digest)?)
        .map_err(|error| StageError::new(format!("the list of files beside the photos: {error}")))
}

/// Returns the cameras and points of the chosen file.
fn read(ctx: &Ctx<'_>, files: &BTreeMap<String, Digest>, source: &Source) -> Result<Cameras, StageError> {
    let get = |name: &str| match files.get(name) {
        Some(digest) => ctx.get(digest),
        None => Err(StageError::new(format!(
            "`{name}` is not among the files beside the photos"
        ))),
    };
    let optional = |name: &String| files.get(name).map(|digest| ctx.get(digest)).transpose();
    match source {
        Source::Transforms(names) => {
            let mut cameras = Cameras::default();
            let mut clouds = BTreeSet::new();
            for (name, role) in names {
                let read = read_transforms(name, &get(name)?).map_err(refused)?;
                cameras.views.extend(read.views.into_iter().map(|view| View {
                    role: if view.role == Role::Open { *role } else { view.role },
                    ..view
                }));
                // The parts of a split set may name the same points.
                let cloud = read.points.filter(|cloud| clouds.insert(cloud.clone()));
                if let Some(cloud) = cloud {
                    let bytes = optional(&cloud)?.ok_or_else(|| no_points(name, &cloud))?;
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
        "`{points}` is not among the files beside the photos; points are found as `points.ply` or \
         `sparse_pc.ply` at the top, in sparse/ or in sparse/0/"
    );
    let error = ImportError::new(file, format!("/{POINTS_KEY}"), problem);
    StageError::new(error.to_string()).hint(format!(
        "put the points there, or take `{POINTS_KEY}` out of {file} to go without them"
    ))
}

/// Photos with their views, and what has no partner.
struct MatchedViews<'a> {
    pairs: Vec<(usize, &'a View)>,
    unplaced: Vec<(usize, String)>,
    missing: Vec<Missing>,
}

/// Finds the photo of each view.
fn match_views<'a>(
    source: &Source,
    views: &'a [View],
    items: &[InputPhoto],
) -> Result<MatchedViews<'a>, ImportError> {
    let photos = PhotoNames::new(items);
    let mut taken: BTreeMap<usize, &View> = BTreeMap::new();
    let mut missing = Vec::new();
    for view in views {
        let Some(item) = photos.find(&view.file) else {
            let reason = "not among the photos: filtered out, or not in the archive".to_owned();
            missing.push(Missing {
                file: view.file.clone(),
                reason,
            });
            continue;
        };
        if let Some(first) = taken.insert(item, view) {
            let problem = format!(
                "the photo `{}` has a camera at {} already",
                items[item].id, first.place
            );
            return Err(ImportError::new(&source.name(), &view.place, problem));
        }
    }
    missing.sort_by(|a, b| a.file.cmp(&b.file));
    let reason = |index: &usize| match taken.get(index) {
        None => Some(format!("{} has no camera for it", source.name())),
        Some(view) if view.role == Role::Unlisted => Some(format!(
            "{} lists it neither for training nor for measuring",
            source.name()
        )),
        Some(_) => None,
    };
    let unplaced: Vec<_> = (0..items.len())
        .filter_map(|index| Some((index, reason(&index)?)))
        .collect();
    let pairs = taken
        .into_iter()
        .filter(|(_, view)| view.role != Role::Unlisted)
        .collect();
    Ok(MatchedViews {
        pairs,
        unplaced,
        missing,
    })
}

/// A photo at the size that the field is trained on, with its camera.
pub(crate) struct SizedPhoto {
    image: Digest,
    file: String,
    camera: Camera,
}

/// Returns a photo with the camera of its view; `file` is named in errors.
pub(crate) fn sized_photo(
    ctx: &Ctx<'_>,
    file: &str,
    view: &View,
    item: &InputPhoto,
    params: &CalibrateParams,
) -> Result<SizedPhoto, StageError> {
    let (width, height) = match (item.facts.width, item.facts.height) {
        (0, _) | (_, 0) => {
            let photo = decode(ctx, item)?.image;
            (photo.width, photo.height)
        }
        size => size,
    };
    let camera = view.lens.camera(width, height).map_err(|problem| {
        let problem = format!("photo `{}`: {problem}", item.id);
        refused(ImportError::new(file, &view.place, problem))
    })?;
    let factor = reduction(camera.width, camera.height, params.longest_side_px);
    if factor == 1 {
        return Ok(SizedPhoto {
            image: item.image,
            file: item.facts.file.clone(),
            camera,
        });
    }
    let size_px = [camera.width, camera.height];
    Ok(SizedPhoto {
        image: reduced(ctx, &item.id, &item.image, size_px, factor)?,
        file: as_png(&item.facts.file),
        camera: camera.box_reduced(factor),
    })
}

/// Returns a photo of the input set where its view has it.
pub(crate) fn placed(item: usize, view: &View, photo: SizedPhoto) -> PlacedPhoto {
    PlacedPhoto {
        item,
        file: photo.file,
        image: photo.image,
        camera: photo.camera,
        cam_from_world: view.cam_from_world,
        held_out: match view.role {
            Role::Open => None,
            Role::HeldOut => Some(HeldOut::Yes),
            Role::Train | Role::Unlisted => Some(HeldOut::No),
        },
        statistics: PhotoStatistics {
            matches: view.matches,
            inliers: view.inliers,
            error_px: view.error_px,
            ..PhotoStatistics::default()
        },
    }
}
