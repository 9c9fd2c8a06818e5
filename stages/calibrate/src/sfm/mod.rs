//! Structure from motion: photos alone, with labels as priors where there are some.
//!
//! Features and pairs are kept in memos by what they depend on, so that new photos cost only themselves; the
//! mapping is done again from all of them, and so is a function of the set.

mod answer;
mod cameras;
mod earlier;
#[cfg(test)]
mod extremes;
mod pairs;
mod prepare;
mod reasons;
#[cfg(test)]
mod synthetic;
mod table;

use std::collections::BTreeMap;

use marf_cache::Digest;
use marf_scene::Camera;
use marf_stage::{Ctx, Inputs, StageError};
use rayon::prelude::*;

use crate::bundle::LensModel;
use crate::labels;
use crate::mapper::{
    CentreChoice, LensChoice, Link, MapError, MapOptions, Model, SharedCamera, Task, Tracks, View, map,
};
use crate::metric::{LabelPose, Outvoted, place};
use crate::params::{CalibrateParams, LensParam, PrincipalPoint};
use crate::photos::{Calibrated, Item};
use crate::two_view::{ViewPoints, relate};
use pairs::Compared;
use prepare::Prepared;

/// Largest reprojection error that is kept, for a photo of 1000 px.
const MAX_ERROR_PX: f64 = 4.0;
/// Smallest angle under which a point is seen (COLMAP).
const MIN_ANGLE_RAD: f64 = 1.5 * std::f64::consts::PI / 180.0;

/// Everything known when the mapping is done.
struct Solved<'a> {
    items: &'a [Item],
    prepared: &'a [Prepared],
    compared: &'a [Compared],
    task: &'a Task<'a>,
    models: &'a [Model],
    /// By model: whether it stands in the labels' site, and whose labels it outvoted.
    metric: &'a [Option<Vec<Outvoted>>],
}

/// Places photos by what they show of each other.
pub(crate) fn run(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    items: &[Item],
    params: &CalibrateParams,
) -> Result<Calibrated, StageError> {
    let candidates = labels::of_one_site(items, params.site);
    let prepared = prepare::prepare(ctx, inputs, items, &candidates, params)?;
    let (mut shared, views) = cameras::group(items, &prepared, params);
    let chosen = pairs::choose(&prepared, &sequence(items), params);
    let compared = pairs::compare(ctx, &prepared, &views, &shared, &chosen, params)?;
    cameras::refine_guesses(&mut shared, &views, &compared);
    let links = links(&views, &shared, &compared, params);
    ctx.check()?;
    let total = prepared.len() as u64;
    let task = Task {
        views: &views,
        cameras: &shared,
        links: &links,
        tracks: Tracks::build(&views, &links),
        options: options(params, &shared),
        stop: &|| ctx.cancel.is_set(),
        placed: &|placed| ctx.progress.at(placed as u64, total, "photos placed"),
    };
    let earlier = earlier::load(ctx, inputs, items, &task)?;
    let mut models = match &earlier {
        Some(earlier) => earlier.extend(&task).map_err(stopped)?,
        None => map(&task).map_err(stopped)?,
    };
    let metric = match &earlier {
        Some(_) => vec![None; models.len()],
        None => to_site(&task, &mut models, &labels_of(items, &prepared))?,
    };
    let solved = Solved {
        items,
        prepared: &prepared,
        compared: &compared,
        task: &task,
        models: &models,
        metric: &metric,
    };
    answer::answer(ctx, &solved, earlier.as_ref(), params)
}

fn stopped(error: MapError) -> StageError {
    match error {
        MapError::Stopped => StageError::Cancelled,
        other => StageError::new(other.to_string()),
    }
}

/// Brings each model into the site of its labels, where it has enough that agree.
fn to_site(
    task: &Task<'_>,
    models: &mut [Model],
    labels: &[Option<LabelPose>],
) -> Result<Vec<Option<Vec<Outvoted>>>, StageError> {
    let placed = models.iter_mut().map(|model| place(task, model, labels));
    placed.collect::<Result<_, _>>().map_err(stopped)
}

/// Photos in the order they were most likely taken: by sol, then by name with numbers as numbers.
fn sequence(items: &[Item]) -> Vec<usize> {
    let name = |photo: &usize| {
        let item = &items[*photo];
        (item.facts.sol, natural(&item.facts.file), item.id.clone())
    };
    let mut order: Vec<usize> = (0..items.len()).collect();
    order.sort_by_cached_key(name);
    order
}

/// A name as text and numbers in turn, so that `img_9` comes before `img_10`.
fn natural(name: &str) -> Vec<(String, u128)> {
    let mut parts = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let text = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let (text, after) = rest.split_at(text);
        let digits = after.find(|c: char| !c.is_ascii_digit()).unwrap_or(after.len());
        let (digits, after) = after.split_at(digits);
        let number = match digits {
            "" => 0,
            digits => digits.parse().unwrap_or(u128::MAX),
        };
        parts.push((text.to_owned(), number));
        rest = after;
    }
    parts
}

/// 4 px at 1000 px.
fn max_error_px(camera: &Camera) -> f64 {
    MAX_ERROR_PX * f64::from(camera.width.max(camera.height)) / 1000.0
}

fn options(params: &CalibrateParams, shared: &[SharedCamera]) -> MapOptions {
    let largest = shared
        .iter()
        .map(|shared| max_error_px(&shared.camera))
        .fold(0.0, f64::max);
    // Photos resampled through their label's lens are pinholes until the data say otherwise.
    let labelled = shared
        .iter()
        .all(|shared| shared.focal_sigma_share.is_some_and(|sigma| sigma < 0.05));
    MapOptions {
        max_error_px: largest,
        min_angle_rad: MIN_ANGLE_RAD,
        lens: match params.lens {
            LensParam::Auto if labelled => LensChoice::Smallest {
                growing: LensModel::Pinhole,
            },
            LensParam::Auto => LensChoice::Smallest {
                growing: LensModel::Radial,
            },
            LensParam::Pinhole => LensChoice::Fixed(LensModel::Pinhole),
            LensParam::SimpleRadial => LensChoice::Fixed(LensModel::SimpleRadial),
            LensParam::Radial => LensChoice::Fixed(LensModel::Radial),
            LensParam::Opencv => LensChoice::Fixed(LensModel::OpenCv),
        },
        centre: match params.principal_point {
            PrincipalPoint::Centre => CentreChoice::Held,
            PrincipalPoint::Free => CentreChoice::Free,
            PrincipalPoint::Auto if labelled => CentreChoice::Held,
            PrincipalPoint::Auto => CentreChoice::Supported,
        },
        seed: params.seed,
    }
}

fn lens_name(lens: LensModel) -> &'static str {
    match lens {
        LensModel::Pinhole => "pinhole",
        LensModel::SimpleRadial => "simple radial",
        LensModel::Radial => "radial",
        LensModel::OpenCv => "radial and tangential",
    }
}

/// What each verified pair says now that focal lengths are known or estimated.
fn links(
    views: &[View],
    cameras: &[SharedCamera],
    compared: &[Compared],
    params: &CalibrateParams,
) -> Vec<Link> {
    let related: Vec<Option<Link>> = compared
        .par_iter()
        .map(|one| {
            let points = |photo: usize| ViewPoints {
                camera: &cameras[views[photo].camera].camera,
                pixels: &views[photo].pixels,
            };
            let [a, b] = one.photos;
            let inliers = &one.verified.inliers;
            if inliers.len() < params.min_matches as usize {
                return None;
            }
            let seed = pairs::seed_of(&Digest::of(
                &inliers
                    .iter()
                    .flatten()
                    .flat_map(|i| i.to_le_bytes())
                    .collect::<Vec<u8>>(),
            ));
            let error_px = max_error_px(points(a).camera);
            let focal = pairs::focal_known(views, cameras, one.photos);
            let seed = seed ^ params.seed;
            let relation = relate(&points(a), &points(b), inliers, focal, error_px, seed)?;
            (relation.inliers.len() >= params.min_matches as usize).then_some(Link {
                photos: one.photos,
                relation,
            })
        })
        .collect();
    related.into_iter().flatten().collect()
}

/// The label of each photo, if it has one of the chosen site.
fn labels_of(items: &[Item], prepared: &[Prepared]) -> Vec<Option<LabelPose>> {
    let label = |(photo, one): (usize, &Prepared)| {
        let (_, cam_from_site) = one.row.label?;
        let facts = &items[photo].facts;
        Some(LabelPose {
            cam_from_site,
            motion_counter: facts.prior.as_ref()?.motion_counter.clone(),
            instrument: facts.instrument.clone().unwrap_or_default(),
        })
    };
    prepared.iter().enumerate().map(label).collect()
}

/// Groups linked photos; returns each photo's component, the largest first, ties by first photo.
fn components(count: usize, links: &[Link]) -> Vec<usize> {
    let mut root: Vec<usize> = (0..count).collect();
    fn find(root: &[usize], mut photo: usize) -> usize {
        while root[photo] != photo {
            photo = root[photo];
        }
        photo
    }
    for link in links {
        let [a, b] = link.photos.map(|photo| find(&root, photo));
        root[a.max(b)] = a.min(b);
    }
    let roots: Vec<usize> = (0..count).map(|photo| find(&root, photo)).collect();
    let mut sizes: BTreeMap<usize, usize> = BTreeMap::new();
    roots
        .iter()
        .for_each(|root| *sizes.entry(*root).or_default() += 1);
    let mut order: Vec<(usize, usize)> = sizes.into_iter().collect();
    order.sort_by_key(|&(root, size)| (std::cmp::Reverse(size), root));
    let rank = |root: &usize| order.iter().position(|(other, _)| other == root).unwrap_or(0);
    roots.iter().map(rank).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_count_as_numbers() {
        let mut names = ["f10.jpg", "f9.jpg", "f1a.jpg", "e99.jpg", "f", ""];
        names.sort_by_key(|name| natural(name));
        assert_eq!(names, ["", "e99.jpg", "f", "f1a.jpg", "f9.jpg", "f10.jpg"]);
    }
}
