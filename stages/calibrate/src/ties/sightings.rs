//! Points of two scenes that photos of both show.

use std::collections::BTreeMap;

use marf_cache::digest_of;
use marf_schema::calibrate::CalibrateParams;
use marf_sfm::align::Sighting;
use marf_sfm::view_graph::max_error_px;
use marf_sfm_features::matching::match_pair;
use marf_sfm_features::two_view::{FocalKnown, VerifiedKind, VerifyOptions, ViewPoints, verify};
use marf_stage::{Ctx, StageError};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use super::world::World;
use crate::sfm::{PhotoFeatures, seed_of};

/// A feature and a point are one if the point falls so near, pixels of the working size: points were found from these features.
const SAME_PX: f64 = 1.0;

/// A point of each of two scenes that matches say are one, and where a photo of each shows it.
pub(super) struct PointPair([ObservedPoint; 2]);

/// A point of a scene in a photo of it, by their indices.
#[derive(Clone, Copy)]
struct ObservedPoint {
    photo: usize,
    point: usize,
    pixel: Vector2<f64>,
}

impl PointPair {
    /// Returns them as what an alignment takes.
    pub(super) fn sightings<'w>(&self, worlds: [&'w World; 2]) -> [Sighting<'w>; 2] {
        [0, 1].map(|side| {
            let (ObservedPoint { photo, point, pixel }, scene) = (self.0[side], &worlds[side].scene);
            let frame = &scene.frames[photo];
            Sighting {
                point: Vector3::from(scene.points[point].position),
                cam_from_world: &frame.cam_from_world,
                camera: &frame.camera,
                pixel,
                max_error_px: max_error_px(&frame.camera),
            }
        })
    }
}

/// Returns how many of these pairs of photos have matches of points of both scenes, and these points, each pair of points once.
pub(super) fn point_pairs(
    ctx: &Ctx<'_>,
    worlds: [&World; 2],
    pairs: &[[usize; 2]],
    seed: u64,
) -> Result<(u32, Vec<PointPair>), StageError> {
    let mut photos: Vec<(usize, usize)> = pairs.iter().flat_map(|[a, b]| [(0, *a), (1, *b)]).collect();
    photos.sort_unstable();
    photos.dedup();
    let seen = photos.par_iter().map(|&(side, photo)| {
        ctx.check()?;
        Ok(((side, photo), PhotoPoints::new(ctx, worlds[side], photo)?))
    });
    let seen: BTreeMap<(usize, usize), PhotoPoints> = seen.collect::<Result<_, StageError>>()?;
    let found = pairs.par_iter().map(|&[a, b]| {
        ctx.check()?;
        Ok(joined([&seen[&(0, a)], &seen[&(1, b)]], seed))
    });
    let found: Vec<Vec<[ObservedPoint; 2]>> = found.collect::<Result<_, StageError>>()?;
    let joining = found.iter().filter(|pairs| !pairs.is_empty()).count();
    let mut once: BTreeMap<[usize; 2], PointPair> = BTreeMap::new();
    for [a, b] in found.into_iter().flatten() {
        once.entry([a.point, b.point]).or_insert(PointPair([a, b]));
    }
    Ok((joining as u32, once.into_values().collect()))
}

/// A photo with its features, and the point of the scene that each is.
struct PhotoPoints {
    photo: usize,
    found: PhotoFeatures,
    /// Positions of the features, pixels of the working size.
    pixels: Vec<Vector2<f64>>,
    /// Camera of that size.
    camera: marf_scene::Camera,
    points: Vec<Option<usize>>,
}

impl PhotoPoints {
    fn new(ctx: &Ctx<'_>, world: &World, photo: usize) -> Result<Self, StageError> {
        let found = world.features(ctx, photo)?;
        let pixels = found.pixels();
        let frame = &world.scene.frames[photo];
        let camera = frame.camera.box_reduced(found.row.factor);
        let fallen = world
            .scene
            .points
            .iter()
            .enumerate()
            .filter_map(|(index, point)| {
                let seen = camera.project(&frame.cam_from_world.point(&Vector3::from(point.position)))?;
                let inside = (0.0..f64::from(camera.width)).contains(&seen.x)
                    && (0.0..f64::from(camera.height)).contains(&seen.y);
                inside.then_some((seen, index))
            });
        let mut fallen: Vec<(Vector2<f64>, usize)> = fallen.collect();
        fallen.sort_unstable_by(|(a, i), (b, j)| a.x.total_cmp(&b.x).then(i.cmp(j)));
        let points = pixels.iter().map(|pixel| nearest(&fallen, pixel)).collect();
        Ok(Self {
            photo,
            found,
            pixels,
            camera,
            points,
        })
    }
}

/// Returns the nearest of positions, sorted from left to right, if it is near enough.
fn nearest(fallen: &[(Vector2<f64>, usize)], pixel: &Vector2<f64>) -> Option<usize> {
    let first = fallen.partition_point(|(at, _)| at.x < pixel.x - SAME_PX);
    let near = fallen[first..]
        .iter()
        .take_while(|(at, _)| at.x <= pixel.x + SAME_PX);
    let near = near.map(|(at, index)| ((at - pixel).norm(), *index));
    let near = near.filter(|(distance, _)| *distance <= SAME_PX);
    near.min_by(|(a, i), (b, j)| a.total_cmp(b).then(i.cmp(j)))
        .map(|(_, index)| index)
}

/// Returns the points that verified matches of two photos join.
fn joined(seen: [&PhotoPoints; 2], seed: u64) -> Vec<[ObservedPoint; 2]> {
    let [a, b] = seen;
    let matches = match_pair(&a.found.features, &b.found.features);
    let views = seen.map(|one| ViewPoints {
        camera: &one.camera,
        pixels: &one.pixels,
    });
    let options = VerifyOptions {
        max_error_px: max_error_px(&a.camera),
        min_inliers: CalibrateParams::default().min_matches,
    };
    let seed = seed_of(&digest_of(&(seen.map(|one| one.found.row.found), seed)));
    let verified = verify(
        [&views[0], &views[1]],
        &matches,
        FocalKnown::Known,
        &options,
        seed,
    );
    if !matches!(verified.kind, VerifiedKind::General | VerifiedKind::Planar) {
        return Vec::new();
    }
    let joined = verified.inliers.iter().filter_map(|features| {
        let observed = |side: usize| {
            let (one, feature) = (seen[side], features[side] as usize);
            Some(ObservedPoint {
                photo: one.photo,
                point: one.points[feature]?,
                pixel: one.pixels[feature] * f64::from(one.found.row.factor),
            })
        };
        Some([observed(0)?, observed(1)?])
    });
    joined.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_position_within_a_pixel_is_found() {
        let at = |x: f64, y: f64| Vector2::new(x, y);
        let fallen = [
            (at(1.0, 9.0), 4),
            (at(2.0, 2.0), 7),
            (at(2.5, 2.0), 1),
            (at(9.0, 9.0), 0),
        ];
        assert_eq!(nearest(&fallen, &at(2.1, 2.0)), Some(7));
        assert_eq!(nearest(&fallen, &at(2.4, 2.1)), Some(1));
        assert_eq!(nearest(&fallen, &at(3.5, 2.0)), Some(1), "at the limit");
        assert_eq!(nearest(&fallen, &at(3.6, 2.0)), None);
        assert_eq!(nearest(&[], &at(0.0, 0.0)), None);
    }
}
