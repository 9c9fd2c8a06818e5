//! Which photos of two scenes may show the same.

use std::cmp::Reverse;

use marf_sfm::align::Similarity;
use marf_sfm::view_graph::PosedCamera;
use marf_sfm_features::features::Features;
use marf_sfm_features::matching::Samples;
use marf_stage::{Ctx, StageError};
use nalgebra::Vector3;
use rayon::prelude::*;

use super::world::World;
use crate::sfm::{PhotoFeatures, view_overlap};

/// Photos whose cameras are further apart are not compared: twice the distance up to which overlap is looked for.
const REACH_M: f64 = 60.0;
/// Photos of a scene, evenly chosen, for a rough comparison where labels do not show which ones overlap.
const SAMPLED: usize = 40;
/// Fewest matches of a rough comparison.
const LEAST_MATCHES: usize = 6;

/// Returns whether photos of two scenes may show the same ground by their labels. Different sites may not. In one site, cameras of both
/// must be near each other.
pub(super) fn may_overlap(worlds: [&World; 2]) -> bool {
    match worlds.map(World::site_from_world) {
        [Some((site, first)), Some((other, second))] => {
            let centres = |world: &World, site_from_world: &Similarity| -> Vec<Vector3<f64>> {
                let frames = world.scene.frames.iter();
                frames
                    .map(|frame| site_from_world.point(&frame.cam_from_world.centre()))
                    .collect()
            };
            let second = centres(worlds[1], &second);
            let is_near = |a: &Vector3<f64>| second.iter().any(|b| (a - b).norm() <= REACH_M);
            site == other && centres(worlds[0], &first).iter().any(is_near)
        }
        _ => true,
    }
}

/// Returns the pairs of photos of two scenes that most likely show the same ground, the likeliest `most` of them, sorted. In one site they
/// are chosen by their poses, otherwise by a rough comparison.
pub(super) fn chosen(ctx: &Ctx<'_>, worlds: [&World; 2], most: usize) -> Result<Vec<[usize; 2]>, StageError> {
    let mut ranked = match worlds.map(World::site_from_world) {
        [Some((_, first)), Some((_, second))] => {
            let views = |world: &World, site_from_world| -> Vec<PosedCamera> {
                let photos = 0..world.scene.frames.len();
                photos
                    .map(|photo| world.view_in_site(photo, site_from_world))
                    .collect()
            };
            by_pose(&views(worlds[0], &first), &views(worlds[1], &second))
        }
        _ => by_look(ctx, worlds)?,
    };
    ranked.sort_unstable_by_key(|&(pair, rank)| (Reverse(rank), pair));
    let mut pairs: Vec<[usize; 2]> = ranked.into_iter().take(most).map(|(pair, _)| pair).collect();
    pairs.sort_unstable();
    Ok(pairs)
}

/// Ranks pairs by how much the poses say that they overlap.
fn by_pose(first: &[PosedCamera], second: &[PosedCamera]) -> Vec<([usize; 2], usize)> {
    let of_photo = |a: usize| {
        let rank = move |b: usize| {
            let (view, other) = (&first[a], &second[b]);
            let is_near = (view.cam_from_world.centre() - other.cam_from_world.centre()).norm() <= REACH_M;
            let both = is_near.then(|| view_overlap(view, other).min(view_overlap(other, view)))?;
            (both > 0).then_some(([a, b], both))
        };
        (0..second.len()).into_par_iter().filter_map(rank)
    };
    (0..first.len()).into_par_iter().flat_map(of_photo).collect()
}

/// Ranks pairs by the matches of a sample of their features.
fn by_look(ctx: &Ctx<'_>, worlds: [&World; 2]) -> Result<Vec<([usize; 2], usize)>, StageError> {
    let sampled = worlds.map(|world| {
        let count = world.scene.frames.len();
        let taken = count.min(SAMPLED);
        (0..taken)
            .map(|index| index * count / taken)
            .collect::<Vec<usize>>()
    });
    let photos: Vec<(usize, usize)> = (0..2)
        .flat_map(|side| sampled[side].iter().map(move |photo| (side, *photo)))
        .collect();
    let features = photos.par_iter().map(|&(side, photo)| {
        ctx.check()?;
        worlds[side].features(ctx, photo)
    });
    let features: Vec<PhotoFeatures> = features.collect::<Result<_, StageError>>()?;
    let found: Vec<&Features> = features.iter().map(|one| &one.features).collect();
    let samples = Samples::new(&found);
    let split = sampled[0].len();
    let pairs: Vec<(usize, usize)> = (0..split)
        .flat_map(|a| (split..found.len()).map(move |b| (a, b)))
        .collect();
    let ranked = pairs.par_iter().filter_map(|&(a, b)| {
        let matches = samples.matches(a, b);
        (matches >= LEAST_MATCHES).then_some(([photos[a].1, photos[b].1], matches))
    });
    Ok(ranked.collect())
}
