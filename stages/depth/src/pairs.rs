//! Which photos are matched with which: chosen from cameras and sparse points.

use marf_numeric::{quantile, upper_median};
use marf_scene::Scene;
use rayon::prelude::*;
use thiserror::Error;

use crate::overlap::{FEWEST, Overlap, Surface, are_twins};
use crate::rectify::{PosedCamera, Rectified, RectifyError};
use crate::search::{MAX_DISPARITIES, Search};

/// Most points of a pair.
const MOST_OF_PAIR: usize = 512;

/// Least share of the points of either photo that both show.
const LEAST_OVERLAP: f64 = 0.3;
/// Below this angle there is hardly any depth: a baseline of 0.005 of the distance.
const LEAST_DEG: f64 = 0.3;
/// Above this angle photos look too different.
const MOST_DEG: f64 = 30.0;
/// The best angle of a photo's first pair. More narrow photos look alike, so that nearly every pixel is matched.
const FIRST_DEG: f64 = 4.0;
/// The best angle of its other pairs, whose depths are the more exact ones.
const OTHERS_DEG: f64 = 8.0;
/// The largest ratio of the sizes at which photos show the same.
const MOST_SCALE: f64 = 3.5;

/// How much nearer and farther than the sparse points surfaces are looked for.
const NEARER: f64 = 1.5;
const FARTHER: f64 = 0.6;
/// The share of the points that may be outliers, on each side.
const OUTLIERS: f64 = 0.01;
/// Disparities added on each side, pixels.
const MARGIN_PX: f64 = 4.0;
/// Infinity is looked at too if it is at most this number of disparities away.
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
    /// The smaller of the two scales at which the photos show the same, as a share of the other.
    alike: f64,
}

impl Pair {
    /// Returns how well a pair suits, of which this angle is the best.
    fn score(&self, best_deg: f64) -> f64 {
        self.overlap * self.alike * (self.angle_deg / best_deg).min(best_deg / self.angle_deg)
    }
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
    #[error(
        "the points that both photos show are behind a rectified camera, or more than {MAX_DISPARITIES} pixels apart in the two"
    )]
    NoRange,
    #[error("the photos are not of the two eyes of one mast, and labels alone place others too coarsely")]
    NotTwins,
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
/// them, best 4 degrees for the first pair of a photo and 8 for the others, and the ratio of scales. The range of disparities is that of the points, widened. Of cameras that labels alone place,
/// twins are matched and nothing else, because errors of other poses are as large as the baselines.
pub(crate) fn choose(scene: &Scene, views: &[PosedCamera], neighbours: usize) -> Pairs {
    let surface = Surface::new(scene, views);
    let neighbours = match surface {
        Surface::Twins { .. } => 1,
        Surface::Points { .. } | Surface::Rays { .. } => neighbours,
    };
    let rows = (0..views.len()).into_par_iter().map(|i| {
        let others = i + 1..views.len();
        let judged = others.filter_map(|j| {
            let overlap = surface.overlap([i, j], views);
            let is_candidate = overlap.points.len() >= FEWEST && overlap.share >= LEAST_OVERLAP;
            is_candidate.then(|| (j, judge([i, j], views, &overlap, &surface)))
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
    let mut counts = vec![0; views.len()];
    let mut chosen = take_best(&mut candidates, FIRST_DEG, neighbours.min(1), &mut counts);
    chosen.extend(take_best(&mut candidates, OTHERS_DEG, neighbours, &mut counts));
    // A photo whose neighbours have enough pairs still gets its best one.
    for pair in candidates {
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

/// Takes pairs of photos that have fewer than `most`, the best first, and counts them.
fn take_best(candidates: &mut Vec<Pair>, best_deg: f64, most: usize, counts: &mut [usize]) -> Vec<Pair> {
    // Stable: of equal scores the pair of the first photos.
    candidates.sort_by(|a, b| b.score(best_deg).total_cmp(&a.score(best_deg)));
    let is_free = |pair: &mut Pair| {
        let free = pair.photos.iter().all(|&photo| counts[photo] < most);
        if free {
            pair.photos.iter().for_each(|&photo| counts[photo] += 1);
        }
        free
    };
    candidates.extract_if(.., is_free).collect()
}

/// Judges two photos that overlap.
fn judge(
    photos: [usize; 2],
    views: &[PosedCamera],
    overlap: &Overlap,
    surface: &Surface,
) -> Result<Pair, Refusal> {
    let [a, b] = photos;
    let stride = overlap.points.len().div_ceil(MOST_OF_PAIR);
    let shared: Vec<_> = overlap.points.iter().step_by(stride).collect();
    let centres = photos.map(|photo| views[photo].cam_from_world.centre());
    let angles = shared.iter().map(|shared| {
        let rays = centres.map(|centre| (centre - shared.place).normalize());
        libm::acos(rays[0].dot(&rays[1]).clamp(-1.0, 1.0)).to_degrees()
    });
    let angle_deg = upper_median(angles).unwrap_or(0.0);
    if angle_deg < LEAST_DEG {
        return Err(Refusal::Rotation);
    }
    if let Surface::Twins { widest } = surface
        && !are_twins([&views[a], &views[b]], *widest)
    {
        return Err(Refusal::NotTwins);
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
        let eyes = [(rectified.left, photos[0]), (rectified.right, photos[1])];
        let [left, right] = eyes.map(|(eye, photo)| {
            let seen = views[photo].cam_from_world.point(&shared.place);
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
        overlap: overlap.share,
        alike,
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
    let search = Search {
        first,
        count: ((last - first + 1) as usize).min(MAX_DISPARITIES),
    };
    search.is_within_limits().then_some(search)
}

#[cfg(test)]
mod tests {
    use marf_cache::Digest;
    use marf_scene::{Camera, Frame, Point, Pose};
    use nalgebra::Vector3;

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
    fn the_pair_nearest_to_four_degrees_comes_first_and_the_left_photo_before_the_right_one() {
        // 4 degrees at a distance of 10 are a baseline of 0.7.
        let pairs = chosen(&[[0.7, 0.0, 0.0], [0.0, 0.0, 0.0], [-1.4, 0.0, 0.0]], 1);
        assert_eq!(pairs.chosen[0].photos, [1, 0]);
        assert!(
            (pairs.chosen[0].angle_deg - 4.0).abs() < 0.3,
            "{}",
            pairs.chosen[0].angle_deg
        );
        // 200 px x 0.7 / 10 = 14 px, and the range holds it and infinity.
        let Search { first, count } = pairs.chosen[0].search;
        assert!(first <= 0 && first + count as i32 > 21, "{first} {count}");
        // The third photo has no free neighbour, and still gets one.
        assert_eq!(pairs.chosen.len(), 2);
    }

    #[test]
    fn the_second_pair_of_a_photo_is_the_one_nearest_to_eight_degrees() {
        // From the first photo 4, 6 and 8 degrees.
        let places = [0.0, 0.7, 1.05, -1.4].map(|x| [x, 0.0, 0.0]);
        let pairs = chosen(&places, 2);
        let mut of_first: Vec<f64> = pairs
            .chosen
            .iter()
            .filter(|pair| pair.photos.contains(&0))
            .map(|pair| pair.angle_deg.round())
            .collect();
        of_first.sort_by(f64::total_cmp);
        assert_eq!(of_first, [4.0, 8.0]);
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
            metres_per_unit: Some(1.0),
            ..scene
        };
        let pairs = choose(&bare, &views, 3).chosen;
        assert_eq!(pairs.len(), 1);
        assert_eq!(pairs[0].photos, [0, 1]);
        // Nearest 4.5 baselines, 200 / 4.5 px on the axis, with a half more.
        let Search { first, count } = pairs[0].search;
        assert!(
            first <= 0 && (50..100).contains(&(first + count as i32)),
            "{first} {count}"
        );
    }

    #[test]
    fn cameras_of_labels_are_matched_with_their_twin_alone() {
        let places = [
            [0.0; 3],
            [0.24, 0.0, 0.0],
            [0.0, 0.3, 0.0],
            [2.0, 0.0, 0.0],
            [2.24, 0.0, 0.0],
        ];
        let (scene, views) = scene(&places);
        let bare = Scene {
            points: Vec::new(),
            metres_per_unit: Some(1.0),
            ..scene
        };
        let pairs = choose(&bare, &views, 3);
        let chosen: Vec<_> = pairs.chosen.iter().map(|pair| pair.photos).collect();
        // The third photo is above the first. Two metres are from stop to stop.
        assert_eq!(chosen, [[0, 1], [3, 4]]);
        let refused = |photos| {
            pairs
                .refused
                .iter()
                .find(|one| one.photos == photos)
                .map(|one| one.why)
        };
        assert_eq!(refused([0, 2]), Some(Refusal::NotTwins));
        assert_eq!(refused([0, 3]), Some(Refusal::NotTwins));
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
