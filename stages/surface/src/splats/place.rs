//! Placement of splats on the surfaces that views show, in cells as wide as their pixels.

use std::collections::BTreeMap;

use marf_scene::{Observer, seen_at};
use nalgebra::Vector3;
use rayon::prelude::*;

use super::{SIGMA, Splat};
use crate::extract::SurfaceLimits;
use crate::view::SurfaceView;
use crate::volume::Place;

/// Least side of a cell, in pixels of the view that shows it. Sides are powers of two, so a side is less than
/// twice as much.
const PIXELS: f64 = 1.0;
/// A cell is left to finer ones if they cover this share of it.
const COVERED: f32 = 0.5;
/// Levels of cells, each twice as wide as the one before.
const LEVELS: u8 = 24;
/// The file has the logit of an opacity, and no viewer blends more.
const MOST_OPACITY: f32 = 0.99;

/// Pixels of a cell: sums by weight.
#[derive(Debug, Clone, Copy)]
struct Sum {
    level: u8,
    place: Place,
    /// From the corner of the cell, in its sides.
    offset: [f32; 3],
    normal: [f32; 3],
    color: [f32; 3],
    opacity: f32,
    weight: f32,
}

/// Shares of cells that splats cover, of one level.
type Cover = BTreeMap<Place, f32>;

/// Returns a splat for every cell in which pixels of the views show a surface: the mean of these pixels, each
/// by cos² θ / r² as in [`crate::Volume::fuse`]. A pixel falls into the finest cells that are as wide as
/// itself, or wider. Where finer cells cover a surface, pixels of distant views are left out.
///
/// - `views`: with the opacities of their pixels. `observers`: how far the photo of each saw.
/// - `limits`: no cell is narrower than its cell, no pixel farther than its reach, no splat shown by less than its photos.
///
/// In the order of levels and cells: the same for any number of threads.
pub fn place(views: &[(&SurfaceView, &[f32])], observers: &[Observer], limits: &SurfaceLimits) -> Vec<Splat> {
    let finest = views.iter().filter_map(|(view, _)| finest_width(view));
    let finest = (PIXELS * finest.fold(f64::INFINITY, f64::min)).max(limits.cell.unwrap_or(0.0));
    let reach = limits.reach.unwrap_or(f64::INFINITY);
    let of_views = views
        .par_iter()
        .map(|(view, opacity)| sums(view, opacity, finest, reach));
    let mut all: Vec<Sum> = of_views.collect::<Vec<_>>().concat();
    // Stable: within a cell in the order of the views.
    all.par_sort_by_key(key);
    let merged = merged(&all);
    drop(all);
    let mut splats = Vec::new();
    let mut cover = Cover::new();
    for level in 0..LEVELS {
        let of_level = |sum: &Sum| sum.level.cmp(&level);
        let first = merged.partition_point(|sum| of_level(sum).is_lt());
        let past = merged.partition_point(|sum| of_level(sum).is_le());
        let cell = width(finest, level);
        cover = parents(&cover);
        let open: Vec<&Sum> = merged[first..past]
            .iter()
            .filter(|sum| is_open(sum, &cover))
            .collect();
        for sum in open {
            cover.insert(sum.place, 1.0);
            splats.push(splat(sum, cell));
        }
    }
    if limits.least_photos <= 1 {
        return splats;
    }
    let is_seen = |splat: &Splat| seen_at(observers, &splat.position, None).photos >= limits.least_photos;
    splats.into_par_iter().filter(is_seen).collect()
}

fn key(sum: &Sum) -> (u8, Place) {
    (sum.level, sum.place)
}

/// Returns the side of the cells of a level.
fn width(finest: f64, level: u8) -> f64 {
    finest * f64::from(1_u32 << level)
}

/// Returns the width of the narrowest pixel of a view on its surface, world units.
fn finest_width(view: &SurfaceView) -> Option<f64> {
    let distances = view.points().map(|(_, patch, _)| patch.distance);
    distances
        .min_by(f32::total_cmp)
        .map(|distance| f64::from(distance) * view.pixel_angle())
}

fn sums(view: &SurfaceView, opacity: &[f32], finest: f64, reach: f64) -> Vec<Sum> {
    let mut all: Vec<Sum> = view
        .pixels()
        .filter(|(_, _, patch)| f64::from(patch.distance) <= reach)
        .filter_map(|(pixel, point, patch)| {
            let wanted = PIXELS * f64::from(patch.distance) * view.pixel_angle();
            let level = (0..LEVELS).find(|level| width(finest, *level) >= wanted)?;
            let cell = width(finest, level);
            let place = (point / cell).map(f64::floor);
            let weight = (patch.cosine / patch.distance) * (patch.cosine / patch.distance);
            let by_weight = |of: [f32; 3]| of.map(|value| value * weight);
            Some(Sum {
                level,
                place: place.map(|x| x as i32).into(),
                offset: by_weight((point / cell - place).map(|x| x as f32).into()),
                normal: by_weight(patch.normal),
                color: by_weight(view.colors()[pixel]),
                opacity: opacity[pixel] * weight,
                weight,
            })
        })
        .collect();
    all.sort_by_key(key);
    merged(&all)
}

/// Adds up neighbours of one cell, in order.
fn merged(sorted: &[Sum]) -> Vec<Sum> {
    let plus = |a: [f32; 3], b: [f32; 3]| [0, 1, 2].map(|axis| a[axis] + b[axis]);
    let add = |cell: &[Sum]| {
        cell[1..].iter().fold(cell[0], |sum, one| Sum {
            offset: plus(sum.offset, one.offset),
            normal: plus(sum.normal, one.normal),
            color: plus(sum.color, one.color),
            opacity: sum.opacity + one.opacity,
            weight: sum.weight + one.weight,
            ..sum
        })
    };
    sorted.chunk_by(|a, b| key(a) == key(b)).map(add).collect()
}

/// Returns the cover of cells twice as wide: each cell is a quarter of the surface of its parent.
fn parents(cover: &Cover) -> Cover {
    let mut parents = Cover::new();
    for (place, share) in cover {
        let parent = parents.entry(place.map(|x| x >> 1)).or_insert(0.0);
        *parent = (*parent + share / 4.0).min(1.0);
    }
    parents
}

/// Returns whether finer cells leave a cell open: they do not cover it, nor those before and behind it, where views differ in depth.
fn is_open(sum: &Sum, cover: &Cover) -> bool {
    let normal = Vector3::from(sum.normal).try_normalize(0.0).unwrap_or_default();
    let offset = Vector3::from(sum.offset) / sum.weight;
    let mut places = [-1.0_f32, 0.0, 1.0].map(|aside| {
        let moved = (offset + normal * aside).map(|x| x.floor() as i32);
        [0, 1, 2].map(|axis| sum.place[axis] + moved[axis])
    });
    places.sort_unstable();
    let shares = places
        .chunk_by(|a, b| a == b)
        .filter_map(|same| cover.get(&same[0]));
    shares.sum::<f32>() < COVERED
}

fn splat(sum: &Sum, cell: f64) -> Splat {
    let normal = Vector3::from(sum.normal.map(f64::from));
    let inside = Vector3::from(sum.offset.map(|x| f64::from(x / sum.weight)));
    Splat {
        position: (Vector3::from(sum.place.map(f64::from)) + inside) * cell,
        normal: normal.try_normalize(1e-300).unwrap_or_else(Vector3::z),
        sigma: SIGMA * cell,
        color: sum.color.map(|channel| (channel / sum.weight).clamp(0.0, 1.0)),
        opacity: (sum.opacity / sum.weight).min(MOST_OPACITY),
    }
}

#[cfg(test)]
mod tests {
    use marf_scene::{Camera, Pose};
    use nalgebra::Vector2;

    use super::*;

    const WANTED: SurfaceLimits = SurfaceLimits {
        cell: None,
        reach: None,
        least_photos: 1,
        most_spread: None,
    };

    /// Height of the floor, between the sides of cells.
    const FLOOR: f64 = 0.0167;

    /// A camera at this height above the floor of the world (z up) that looks straight down on it, and takes it for higher by `error`.
    fn above(height: f64, error: f64, color: [f32; 3]) -> (SurfaceView, Observer) {
        let camera = Camera::pinhole(60, 60, 60.0);
        let eye = Vector3::new(0.0, 0.0, FLOOR + height);
        let pose = Pose::looking_at(eye, Vector3::zeros(), Vector3::y());
        let pixels =
            (0..3600).map(|pixel| Vector2::new(f64::from(pixel % 60) + 0.5, f64::from(pixel / 60) + 0.5));
        let distance: Vec<f32> = pixels
            .map(|pixel| (camera.unproject(&pixel).unwrap().norm() * (height - error)) as f32)
            .collect();
        let observer = Observer::new(camera, pose, &distance);
        (
            SurfaceView::new(camera, pose, &distance, vec![color; 3600]),
            observer,
        )
    }

    fn placed(of: &[(SurfaceView, Observer)], wanted: &SurfaceLimits) -> Vec<Splat> {
        let opacity = vec![0.95_f32; 3600];
        let views: Vec<_> = of.iter().map(|(view, _)| (view, &opacity[..])).collect();
        let observers: Vec<Observer> = of.iter().map(|(_, observer)| observer.clone()).collect();
        place(&views, &observers, wanted)
    }

    const RED: [f32; 3] = [0.8, 0.2, 0.1];
    const BLUE: [f32; 3] = [0.1, 0.2, 0.8];

    #[test]
    fn a_floor_is_tiled_by_discs_of_one_to_two_pixels() {
        let splats = placed(&[above(2.0, 0.0, RED)], &WANTED);
        // 60 x 60 pixels of 1/30 and wider, in cells of 1/15 but for the middle.
        assert!((900..1300).contains(&splats.len()), "{}", splats.len());
        for splat in &splats {
            assert!(
                (splat.position.z - FLOOR).abs() < 1e-4 && (splat.normal - Vector3::z()).norm() < 1e-3,
                "{splat:?}"
            );
            let pixels = splat.sigma / SIGMA * 30.0;
            assert!((0.999..2.001).contains(&pixels), "{splat:?}");
            assert!(
                (splat.opacity - 0.95).abs() < 1e-4 && (splat.color[0] - 0.8).abs() < 1e-4,
                "{splat:?}"
            );
        }
    }

    #[test]
    fn what_is_seen_from_near_is_not_covered_by_what_is_seen_from_afar() {
        // From 16 a pixel is eight times as wide, and the floor is 0.1 too high.
        let splats = placed(&[above(2.0, 0.0, RED), above(16.0, 0.1, BLUE)], &WANTED);
        let is_blue = |splat: &&Splat| splat.color[2] > 0.5;
        // 16 x 16 in cells of 8/15, around which there is nothing finer.
        let count = splats.iter().filter(is_blue).count();
        assert!((800..1000).contains(&count), "{count}");
        for splat in splats.iter().filter(is_blue) {
            // The near view shows 1 to each side.
            let side = splat.position.x.abs().max(splat.position.y.abs());
            assert!(side > 0.8, "{splat:?}");
        }
    }

    #[test]
    fn cell_reach_and_least_photos_bind() {
        let views = [above(2.0, 0.0, RED)];
        let coarse = placed(
            &views,
            &SurfaceLimits {
                cell: Some(0.1),
                ..WANTED
            },
        );
        let is_wide = |splat: &Splat| (splat.sigma - SIGMA * 0.1).abs() < 1e-12;
        assert!(coarse.iter().all(is_wide) && (400..=484).contains(&coarse.len()));
        assert_eq!(
            placed(
                &views,
                &SurfaceLimits {
                    reach: Some(1.9),
                    ..WANTED
                }
            ),
            vec![]
        );
        assert_eq!(
            placed(
                &views,
                &SurfaceLimits {
                    least_photos: 2,
                    ..WANTED
                }
            ),
            vec![]
        );
        assert_eq!(placed(&[], &WANTED), vec![]);
    }
}
