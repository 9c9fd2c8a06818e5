//! Cameras and points that another program found: transforms.json of instant-ngp and nerfstudio with its PLY,
//! models of COLMAP.

mod choose;
mod colmap;
mod lens;
mod matching;
mod node;
mod ply;
mod transforms;

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::Digest;
use marf_scene::{Camera, Point, Pose};
use marf_stage::{COMPANIONS, Ctx, Inputs, StageError};
use nalgebra::Vector3;
use rayon::prelude::*;

pub use colmap::{Model, read_colmap_binary, read_colmap_text};
pub use lens::{Focal, Lens};
pub use ply::read_ply;
pub use transforms::{Transforms, read_transforms};

use crate::photos::{Calibrated, Found, HeldOut, Item, Placed, as_png, decode, reduction, store};
use crate::{CalibrateParams, Missing};
use choose::{Source, choose};
use matching::Photos;
use transforms::POINTS_KEY;

/// A camera file that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{file}`{}: {problem}", place_text(place))]
pub struct ImportError {
    /// Name of the file beside the photos.
    pub file: String,
    /// JSON pointer, line or record; empty for the whole file.
    pub place: String,
    /// What is wrong, with the value.
    pub problem: String,
}

fn place_text(place: &str) -> String {
    if place.is_empty() {
        String::new()
    } else {
        format!(" {place}")
    }
}

impl ImportError {
    fn new(file: &str, place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self {
            file: file.to_owned(),
            place: place.into(),
            problem: problem.into(),
        }
    }
}

/// A photo's camera as another program has it.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Where in the file it stands, for messages.
    pub place: String,
    /// The photo's name relative to the archive, with `/`; the extension may be missing.
    pub file: String,
    /// Its lens, before the photo's size is known.
    pub lens: Lens,
    /// Its pose: x right, y down, z forward.
    pub cam_from_world: Pose,
    /// What it is for.
    pub role: Role,
    /// Features found in the photo, if the file tells.
    pub matches: Option<u32>,
    /// Those of them that belong to a point, if the file tells.
    pub inliers: Option<u32>,
    /// Their mean distance from their points' projections, pixels of this lens.
    pub error_px: Option<f64>,
}

/// What the file says a photo is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// The file says nothing.
    Open,
    /// Training.
    Train,
    /// Measuring.
    HeldOut,
    /// The file has lists of photos for training and measuring and this one is in none.
    Unlisted,
}

/// Everything of a camera file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Cameras {
    /// One for each photo it has.
    pub views: Vec<View>,
    /// Sparse points, sorted by the file's own number, or in its order.
    pub points: Vec<Point>,
}

/// Places the photos that the chosen file has cameras for; the world is the file's own.
///
/// Its unit is not known to be metres, so `metres_per_unit` stays empty; up is the mean of the cameras' up
/// vectors unless they cancel.
pub(crate) fn run(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    items: &[Item],
    params: &CalibrateParams,
) -> Result<Calibrated, StageError> {
    let files = companions(ctx, inputs)?;
    let source = choose(&files, params.file.as_deref())?;
    let cameras = read(ctx, &files, &source)?;
    let sorted = sort_out(&source, &cameras.views, items).map_err(refused)?;
    let done = sorted.pairs.par_iter().map(|(item, view)| {
        ctx.check()?;
        place(ctx, &source.name(), view, *item, &items[*item], params)
    });
    let placed = done.collect::<Result<Vec<Placed>, StageError>>()?;
    Ok(Calibrated {
        up: mean_up(&placed),
        placed,
        unplaced: sorted.unplaced,
        missing: sorted.missing,
        points: cameras.points,
        tracks: Vec::new(),
        metres_per_unit: None,
        method: format!("import of {}", source.name()),
        components: None,
        seen: Vec::new(),
        cause: None,
        hint: format!(
            "check that the names in {} are those of the photos beside it",
            source.name()
        ),
    })
}

fn refused(error: ImportError) -> StageError {
    StageError::new(error.to_string())
        .hint("correct the file or write it anew; no camera of it was used".to_owned())
}

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
                    cameras.points.extend(read_ply(&cloud, &bytes).map_err(refused)?);
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

/// Complains of points that are named and not there.
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

/// Which photo gets which camera, and what is left over.
struct Sorted<'a> {
    pairs: Vec<(usize, &'a View)>,
    unplaced: Vec<(usize, String)>,
    missing: Vec<Missing>,
}

fn sort_out<'a>(source: &Source, views: &'a [View], items: &[Item]) -> Result<Sorted<'a>, ImportError> {
    let photos = Photos::new(items);
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
    Ok(Sorted {
        pairs,
        unplaced,
        missing,
    })
}

/// Places one photo by its view; `file` is where the view stands, for messages.
pub(crate) fn place(
    ctx: &Ctx<'_>,
    file: &str,
    view: &View,
    index: usize,
    item: &Item,
    params: &CalibrateParams,
) -> Result<Placed, StageError> {
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
    let (image, name, camera) = sized(ctx, item, camera, params)?;
    Ok(Placed {
        item: index,
        file: name,
        image,
        camera,
        cam_from_world: view.cam_from_world,
        held_out: match view.role {
            Role::Open => None,
            Role::HeldOut => Some(HeldOut::Yes),
            Role::Train | Role::Unlisted => Some(HeldOut::No),
        },
        found: Found {
            matches: view.matches,
            inliers: view.inliers,
            error_px: view.error_px,
            ..Found::default()
        },
    })
}

/// The photo and its camera at the working size.
fn sized(
    ctx: &Ctx<'_>,
    item: &Item,
    camera: Camera,
    params: &CalibrateParams,
) -> Result<(Digest, String, Camera), StageError> {
    let factor = reduction(camera.width, camera.height, params.longest_side_px);
    if factor == 1 {
        return Ok((item.image, item.facts.file.clone(), camera));
    }
    let image = decode(ctx, item)?.image;
    if (image.width, image.height) != (camera.width, camera.height) {
        return Err(StageError::new(format!(
            "photo `{}` has {} x {} pixels upright, its facts say {} x {}",
            item.id, image.width, image.height, camera.width, camera.height
        )));
    }
    let image = image.box_reduced(factor);
    Ok((
        store(ctx, item, &image)?,
        as_png(&item.facts.file),
        camera.box_reduced(factor),
    ))
}

/// Mean of the cameras' up vectors, unless they all but cancel.
pub(crate) fn mean_up(placed: &[Placed]) -> Option<[f64; 3]> {
    let down: Vector3<f64> = placed
        .iter()
        .map(|one| one.cam_from_world.rotation.row(1).transpose())
        .sum();
    let clear = down.norm() > 0.1 * placed.len() as f64;
    clear.then(|| (-down.normalize()).into())
}
