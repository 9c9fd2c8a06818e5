//! Which photos are matched with which: chosen from cameras and sparse points.

use marf_numeric::{quantile, upper_median};
use marf_scene::{PosedPhoto, Scene, typical_distance};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;
use thiserror::Error;

use crate::disparities::MAX_DISPARITIES;
use crate::rectify::{PosedCamera, Rectified, RectifyError};
use crate::search::Search;

/// Most points by which pairs are judged, and of a pair.
const MOST_POINTS: usize = 4096;
const MOST_OF_PAIR: usize = 256;
/// Fewest points by which a scene or a pair can be judged.
const FEWEST: usize = 8;
/// Without sparse points, rays of so many places of a photo are followed, per side, to these multiples of a distance: that at which the nearest
/// other photo of another place makes 5 degrees, or the typical one if it is less.
const PLACES: u32 = 5;
const DISTANCES: [f64; 5] = [0.5, 1.0, 2.0, 4.0, 8.0];
const BASELINES: f64 = 12.0;
/// Photos nearer to each other are of one place, as a share of the typical distance.
const ONE_PLACE: f64 = 1e-4;

/// Least share of the points of either photo that both show.
const LEAST_OVERLAP: f64 = 0.3;
/// Below this angle there is hardly any depth: a baseline of 0.005 of the distance.
const LEAST_DEG: f64 = 0.3;
/// Above this angle photos look too different.
const MOST_DEG: f64 = 30.0;
/// The best angle.
const BEST_DEG: f64 = 8.0;
/// The largest ratio of the sizes at which photos show the same.
const MOST_SCALE: f64 = 3.5;

/// How much nearer and farther than the sparse points surfaces are looked for.
const NEARER: f64 = 1.5;
const FARTHER: f64 = 0.6;
/// The share of the points that may be outliers, on each side.
const OUTLIERS: f64 = 0.01;
/// Disparities added on each side, pixels.
const MARGIN_PX: f64 = 4.0;
/// If infinity is at most so many disparities away, it is looked at too.
const TO_INFINITY_PX: f64 = 24.0;
/// Ranges begin and end at multiples of this, so that few of them change with a few points more.
const STEP: i32 = 16;

/// Most pairs of a photo that others take for want of a better one.
pub(crate) const MOST_PAIRS: usize = 16;

/// Two photos to be matched.
#[derive(Debug, Clone)]
pub(crate) struct Pair {
    /// The left and the right one.
    pub photos: [usize; 2],
    pub rectified: Rectified,
    pub search: Search,
    /// Median angle between the rays to a point, degrees.
    pub angle_deg: f64,
    /// Share of the points of the photo with fewer that both show.
    pub overlap: f64,
    score: f64,
}

/// Why overlapping photos are not matched.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub(crate) enum Refusal {
    #[error("the photos were taken from nearly one place: a rotation alone shows no depth")]
    Rotation,
    #[error("the photos look from directions more than {MOST_DEG} degrees apart")]
    TooWide,
    #[error("the photos show the same at sizes that differ by more than a factor of {MOST_SCALE}")]
    Scale,
    #[error("one photo was taken from behind the other")]
    Behind,
    #[error("no row of the rectified photos shows the same")]
    NoCommonRow,
    #[error("the points that both photos show are behind a rectified camera")]
    NoRange,
    #[error("both photos have better neighbours")]
    Better,
}

/// The chosen pairs, and those that are not matched.
pub(crate) struct Pairs {
    pub chosen: Vec<Pair>,
    pub refused: Vec<RefusedPair>,
}

pub(crate) struct RefusedPair {
    pub photos: [usize; 2],
    pub why: Refusal,
}

/// Chooses pairs of photos: for each at most `neighbours`, the best first.
///
/// A pair is judged by the points in view of both cameras, whatever may hide them: their share, the angle between the rays to
/// them, best 8 degrees, and the ratio of scales. The range of disparities is that of the points, widened.
pub(crate) fn choose(scene: &Scene, views: &[PosedCamera], neighbours: usize) -> Pairs {
    let points = points(scene, views);
    let seen: Vec<Vec<Sighting>> = views.par_iter().map(|view| sightings(view, &points)).collect();
    let rows = (0..views.len()).into_par_iter().map(|i| {
        let others = i + 1..views.len();
        let judged = others.filter_map(|j| {
            let shared = shared(&seen[i], &seen[j]);
            let fewer = seen[i].len().min(seen[j].len());
            let overlap = shared.len() as f64 / fewer.max(1) as f64;
            let is_candidate = shared.len() >= FEWEST && overlap >= LEAST_OVERLAP;
            is_candidate.then(|| (j, judge([i, j], views, &points, &shared, overlap)))
        });
        judged.collect::<Vec<_>>()
    });
    let rows: Vec<Vec<_>> = rows.collect();
    let (mut candidates, mut refused) = (Vec::new(), Vec::new());
    for (i, row) in rows.into_iter().enumerate() {
        for (j, judged) in row {
            match judged {
                Ok(pair) => candidates.push(pair),
                Err(why) => refused.push(RefusedPair { photos: [i, j], why }),
            }
        }
    }
    // Stable: of equal scores the pair of the first photos.
    candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut counts = vec![0; views.len()];
    let (mut chosen, rest): (Vec<Pair>, Vec<Pair>) = candidates.into_iter().partition(|pair| {
        let free = pair.photos.iter().all(|&photo| counts[photo] < neighbours);
        if free {
            pair.photos.iter().for_each(|&photo| counts[photo] += 1);
        }
        free
    });
    // A photo whose neighbours have enough pairs still gets its best one.
    for pair in rest {
        let counts_of = || pair.photos.iter().map(|&photo| counts[photo]);
        if counts_of().any(|count| count == 0) && counts_of().all(|count| count < MOST_PAIRS) {
            pair.photos.iter().for_each(|&photo| counts[photo] += 1);
            chosen.push(pair);
        } else {
            let why = Refusal::Better;
            let photos = pair.photos;
            refused.push(RefusedPair { photos, why });
        }
    }
    let order = |pair: &Pair| (pair.photos[0].min(pair.photos[1]), pair.photos);
    chosen.sort_by_key(order);
    Pairs { chosen, refused }
}

/// A point in the view of a photo.
#[derive(Clone, Copy)]
struct Sighting {
    point: u32,
    /// Pixels that a length of one has there.
    scale: f64,
}

/// Returns points of the surface: the sparse ones, evenly strided, or without them places along the rays of the photos.
fn points(scene: &Scene, views: &[PosedCamera]) -> Vec<Vector3<f64>> {
    if scene.points.len() >= FEWEST {
        let stride = scene.points.len().div_ceil(MOST_POINTS);
        let points = scene.points.iter().step_by(stride);
        return points.map(|point| Vector3::from(point.position)).collect();
    }
    let photos: Vec<PosedPhoto<'_>> = scene
        .frames
        .iter()
        .map(|frame| PosedPhoto {
            id: &frame.id,
            camera: &frame.camera,
            cam_from_world: &frame.cam_from_world,
        })
        .collect();
    let typical = typical_distance(&photos, &[]);
    let rays = PLACES as usize * PLACES as usize * DISTANCES.len();
    let stride = (views.len() * rays).div_ceil(4 * MOST_POINTS).max(1);
    let mut points = Vec::new();
    for PosedCamera {
        camera,
        cam_from_world,
    } in views.iter().step_by(stride)
    {
        let world_from_cam = cam_from_world.inverse();
        let apart = |other: &PosedCamera| (other.cam_from_world.centre() - cam_from_world.centre()).norm();
        let others = views.iter().map(apart).filter(|apart| *apart > ONE_PLACE * typical);
        let distance = typical.min(BASELINES * others.fold(f64::INFINITY, f64::min));
        for place in 0..PLACES * PLACES {
            let at = |index: u32, side: u32| (f64::from(index) + 0.5) / f64::from(PLACES) * f64::from(side);
            let pixel = Vector2::new(
                at(place % PLACES, camera.width),
                at(place / PLACES, camera.height),
            );
            if let Some(ray) = camera.unproject(&pixel) {
                points.extend(DISTANCES.map(|far| world_from_cam.point(&(ray.normalize() * far * distance))));
            }
        }
    }
    points
}

fn sightings(view: &PosedCamera, points: &[Vector3<f64>]) -> Vec<Sighting> {
    let PosedCamera {
        camera,
        cam_from_world,
    } = view;
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let sighting = |(index, point): (usize, &Vector3<f64>)| {
        let seen = cam_from_world.point(point);
        let pixel = camera.project(&seen)?;
        let inside = pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < width && pixel.y < height;
        inside.then(|| Sighting {
            point: index as u32,
            scale: camera.fx_px / seen.z,
        })
    };
    points.iter().enumerate().filter_map(sighting).collect()
}

/// A point in the views of two photos.
struct CommonPoint {
    point: u32,
    /// How much larger the first photo shows it.
    scale: f64,
}

/// Returns the points of both, which are sorted by point.
fn shared(a: &[Sighting], b: &[Sighting]) -> Vec<CommonPoint> {
    let (mut both, mut j) = (Vec::new(), 0);
    for one in a {
        while j < b.len() && b[j].point < one.point {
            j += 1;
        }
        if j < b.len() && b[j].point == one.point {
            both.push(CommonPoint {
                point: one.point,
                scale: one.scale / b[j].scale,
            });
        }
    }
    both
}

/// Judges two photos that overlap.
fn judge(
    photos: [usize; 2],
    views: &[PosedCamera],
    points: &[Vector3<f64>],
    shared: &[CommonPoint],
    overlap: f64,
) -> Result<Pair, Refusal> {
    let [a, b] = photos;
    let stride = shared.len().div_ceil(MOST_OF_PAIR);
    let shared: Vec<&CommonPoint> = shared.iter().step_by(stride).collect();
    let centres = photos.map(|photo| views[photo].cam_from_world.centre());
    let angle = |shared: &&CommonPoint| {
        let rays = centres.map(|centre| (centre - points[shared.point as usize]).normalize());
        libm::acos(rays[0].dot(&rays[1]).clamp(-1.0, 1.0)).to_degrees()
    };
    let angle_deg = upper_median(shared.iter().map(angle)).unwrap_or(0.0);
    if angle_deg < LEAST_DEG {
        return Err(Refusal::Rotation);
    }
    if angle_deg > MOST_DEG {
        return Err(Refusal::TooWide);
    }
    let ratio = upper_median(shared.iter().map(|shared| shared.scale)).unwrap_or(1.0);
    let alike = ratio.min(1.0 / ratio);
    if alike < 1.0 / MOST_SCALE {
        return Err(Refusal::Scale);
    }
    let (photos, rectified) = match Rectified::new(&views[a], &views[b]) {
        Err(RectifyError::Swapped) => ([b, a], Rectified::new(&views[b], &views[a])),
        rectified => ([a, b], rectified),
    };
    let rectified = rectified.map_err(|error| match error {
        RectifyError::AlongAxis { .. } => Refusal::Behind,
        RectifyError::NoCommonRow => Refusal::NoCommonRow,
        RectifyError::Rotation | RectifyError::Swapped => Refusal::Rotation,
    })?;
    let disparities = shared.iter().filter_map(|shared| {
        let point = &points[shared.point as usize];
        let eyes = [(rectified.left, photos[0]), (rectified.right, photos[1])];
        let [left, right] = eyes.map(|(eye, photo)| {
            let seen = views[photo].cam_from_world.point(point);
            eye.camera.project(&(eye.photo_from_rectified.transpose() * seen))
        });
        Some(left?.x - right?.x)
    });
    let search = search(&rectified, disparities.collect()).ok_or(Refusal::NoRange)?;
    Ok(Pair {
        photos,
        rectified,
        search,
        angle_deg,
        overlap,
        score: overlap * alike * (angle_deg / BEST_DEG).min(BEST_DEG / angle_deg),
    })
}

/// Returns the range of disparities around those of the points.
fn search(rectified: &Rectified, disparities: Vec<f64>) -> Option<Search> {
    let far = rectified.far_px;
    let least = quantile(disparities.iter().copied(), OUTLIERS)? - far;
    let most = quantile(disparities, 1.0 - OUTLIERS)? - far;
    if most <= 0.0 {
        return None;
    }
    let mut low = FARTHER * least.max(0.0) - MARGIN_PX;
    if low < TO_INFINITY_PX {
        low = -MARGIN_PX;
    }
    let width = f64::from(rectified.left.camera.width);
    let high = (NEARER * most + MARGIN_PX).min(low + width);
    let first = ((low + far).floor() as i32).div_euclid(STEP) * STEP;
    let last = ((high + far).ceil() as i32).div_euclid(STEP) * STEP + STEP - 1;
    Some(Search {
        first,
        count: ((last - first + 1) as usize).min(MAX_DISPARITIES),
    })
}

#[cfg(test)]
mod tests {
    use marf_cache::Digest;
    use marf_scene::{Camera, Frame, Point, Pose};

    use super::*;

    /// Cameras that look along +z, at places along x, at a wall of points at z = 10.
    fn scene(places: &[[f64; 3]]) -> (Scene, Vec<PosedCamera>) {
        let views: Vec<PosedCamera> = places
            .iter()
            .map(|place| PosedCamera {
                camera: Camera::pinhole(200, 100, 200.0),
                cam_from_world: Pose {
                    translation: -Vector3::from(*place),
                    ..Pose::identity()
                },
            })
            .collect();
        let frames = views.iter().enumerate().map(|(index, view)| Frame {
            id: format!("{index}"),
            file: format!("{index}.png"),
            image: Digest::from_content(b""),
            mask: None,
            camera: view.camera,
            cam_from_world: view.cam_from_world,
            held_out: false,
            error_px: None,
        });
        let points = (0..400).map(|index| Point {
            position: [
                f64::from(index % 20) - 10.0,
                f64::from(index / 20) * 0.2 - 2.0,
                10.0,
            ],
            color: None,
            views: 2,
        });
        let scene = Scene {
            frames: frames.collect(),
            points: points.collect(),
            ..Scene::default()
        };
        (scene, views)
    }

    fn chosen(places: &[[f64; 3]], neighbours: usize) -> Pairs {
        let (scene, views) = scene(places);
        choose(&scene, &views, neighbours)
    }

    #[test]
    fn the_pair_nearest_to_eight_degrees_is_chosen_and_the_left_photo_comes_first() {
        // 8 degrees at a distance of 10 are a baseline of 1.4.
        let pairs = chosen(&[[1.4, 0.0, 0.0], [0.0, 0.0, 0.0], [0.3, 0.0, 0.0]], 1);
        assert_eq!(pairs.chosen[0].photos, [1, 0]);
        assert!(
            (pairs.chosen[0].angle_deg - 8.0).abs() < 0.5,
            "{}",
            pairs.chosen[0].angle_deg
        );
        // 200 px x 1.4 / 10 = 28 px, and the range holds it and infinity.
        let Search { first, count } = pairs.chosen[0].search;
        assert!(first <= 0 && first + count as i32 > 42, "{first} {count}");
        // The third photo has no free neighbour, and still gets one.
        assert_eq!(pairs.chosen.len(), 2);
    }

    #[test]
    fn what_gives_no_depth_is_refused_with_the_reason() {
        for (place, why) in [
            ([0.01, 0.0, 0.0], Refusal::Rotation),
            ([6.0, 0.0, 0.0], Refusal::TooWide),
            ([0.0, 0.0, 8.0], Refusal::Scale),
            ([0.3, 0.0, 3.0], Refusal::Behind),
        ] {
            let pairs = chosen(&[[0.0; 3], place], 3);
            assert!(pairs.chosen.is_empty(), "{place:?}");
            assert_eq!(
                pairs.refused.iter().map(|one| one.why).collect::<Vec<_>>(),
                [why],
                "{place:?}"
            );
        }
        // Photos of different things are not even refused.
        let pairs = chosen(&[[0.0; 3], [40.0, 0.0, 0.0]], 3);
        assert!(pairs.chosen.is_empty() && pairs.refused.is_empty());
    }

    #[test]
    fn twins_far_from_other_photos_are_a_pair_without_sparse_points() {
        let (scene, views) = scene(&[[0.0; 3], [0.4, 0.0, 0.0], [900.0, 0.0, 0.0], [-700.0, 0.0, 500.0]]);
        let bare = Scene {
            points: Vec::new(),
            ..scene
        };
        let pairs = choose(&bare, &views, 3).chosen;
        assert_eq!(pairs.len(), 1);
        assert_eq!(pairs[0].photos, [0, 1]);
        // Nearest 6 baselines, 200 / 6 px, with a half more.
        let Search { first, count } = pairs[0].search;
        assert!(first <= 0 && (50..100).contains(&(first + count as i32)), "{first} {count}");
    }

    #[test]
    fn without_sparse_points_places_along_the_rays_decide() {
        let (scene, views) = scene(&[[0.0; 3], [0.25, 0.0, 0.0]]);
        let bare = Scene {
            points: Vec::new(),
            ..scene
        };
        assert_eq!(choose(&bare, &views, 3).chosen.len(), 1);
    }
}
