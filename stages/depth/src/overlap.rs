//! What two photos show both: sparse points, or without them places along their rays.

use marf_scene::{PosedPhoto, Scene, typical_distance};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use crate::rectify::PosedCamera;

/// Most sparse points by which pairs are judged.
const MOST_POINTS: usize = 4096;
/// Fewest points by which a scene or a pair can be judged.
pub(crate) const FEWEST: usize = 8;
/// Places a side of each photo by which a pair without sparse points is judged.
const PLACES: u32 = 5;
/// Multiples of a distance at which these places are taken along their rays. The distance is that at which the photos make 5 degrees, or the
/// typical one if it is less. The nearest is where a Mastcam-Z sees the targets on its deck.
const DISTANCES: [f64; 7] = [0.375, 0.5, 1.0, 2.0, 4.0, 8.0, 1e3];
const BASELINES: f64 = 12.0;
/// Photos nearer to each other are of one place, as a share of the typical distance.
const ONE_PLACE: f64 = 1e-4;
/// Eyes of one mast are at most this far apart, metres, and side by side: cosine between baseline and rows.
const WIDEST_RIG_M: f64 = 1.0;
const SIDE_BY_SIDE: f64 = 0.9;

/// A point in the view of a photo.
#[derive(Clone, Copy)]
pub(crate) struct Sighting {
    point: u32,
    /// Pixels that a length of one has there.
    scale: f64,
}

/// What pairs are judged by.
pub(crate) enum Surface {
    /// Sparse points, evenly strided, and those that each photo shows.
    Points {
        points: Vec<Vector3<f64>>,
        seen: Vec<Vec<Sighting>>,
    },
    /// Places along the rays, for photos of this typical distance.
    Rays { typical: f64 },
    /// Places along the rays of twins, for cameras of labels.
    Twins { widest: f64 },
}

impl Surface {
    pub fn new(scene: &Scene, views: &[PosedCamera]) -> Self {
        if scene.points.len() >= FEWEST {
            let stride = scene.points.len().div_ceil(MOST_POINTS);
            let points = scene.points.iter().step_by(stride);
            let points: Vec<_> = points.map(|point| Vector3::from(point.position)).collect();
            let seen = views.par_iter().map(|view| sightings(view, &points)).collect();
            return Self::Points { points, seen };
        }
        // A scale without points is that of labels.
        if let Some(metres) = scene.metres_per_unit {
            let widest = WIDEST_RIG_M / metres;
            return Self::Twins { widest };
        }
        let photos = scene.frames.iter().map(|frame| PosedPhoto {
            id: &frame.id,
            camera: &frame.camera,
            cam_from_world: &frame.cam_from_world,
        });
        let typical = typical_distance(&photos.collect::<Vec<_>>(), &[]);
        Self::Rays { typical }
    }

    /// Returns the points that two photos show.
    pub fn overlap(&self, pair: [usize; 2], views: &[PosedCamera]) -> Overlap {
        let eyes = pair.map(|photo| &views[photo]);
        let apart = (eyes[0].cam_from_world.centre() - eyes[1].cam_from_world.centre()).norm();
        let distance = match self {
            Self::Points { points, seen } => {
                return Overlap::new(points, pair.map(|photo| seen[photo].as_slice()));
            }
            Self::Rays { typical } if apart <= ONE_PLACE * typical => *typical,
            Self::Rays { typical } => typical.min(BASELINES * apart),
            Self::Twins { widest } => BASELINES * apart.min(*widest),
        };
        let all = DISTANCES.map(|far| {
            let places = eyes.into_iter().flat_map(|eye| along_rays(eye, far * distance));
            let points: Vec<Vector3<f64>> = places.collect();
            let seen = eyes.map(|eye| sightings(eye, &points));
            Overlap::new(&points, [&seen[0], &seen[1]])
        });
        let shares = all.iter().map(|one| one.share);
        Overlap {
            share: match self {
                // Parts of photos overlap at the distance of what they are for, and nowhere else.
                Self::Twins { .. } => shares.fold(0.0, f64::max),
                Self::Rays { .. } | Self::Points { .. } => shares.sum::<f64>() / DISTANCES.len() as f64,
            },
            points: all.into_iter().flat_map(|one| one.points).collect(),
        }
    }
}

/// Returns whether two cameras are at most `widest` apart, side by side.
pub(crate) fn are_twins(eyes: [&PosedCamera; 2], widest: f64) -> bool {
    let between = eyes[1].cam_from_world.centre() - eyes[0].cam_from_world.centre();
    let row = eyes.map(|eye| eye.cam_from_world.rotation.row(0).transpose());
    let along = between.dot(&(row[0] + row[1]).normalize()).abs();
    between.norm() <= widest && along >= SIDE_BY_SIDE * between.norm()
}

fn along_rays(eye: &PosedCamera, distance: f64) -> Vec<Vector3<f64>> {
    let PosedCamera {
        camera,
        cam_from_world,
    } = eye;
    let world_from_cam = cam_from_world.inverse();
    let mut points = Vec::new();
    for place in 0..PLACES * PLACES {
        let at = |index: u32, side: u32| (f64::from(index) + 0.5) / f64::from(PLACES) * f64::from(side);
        let pixel = Vector2::new(
            at(place % PLACES, camera.width),
            at(place / PLACES, camera.height),
        );
        if let Some(ray) = camera.unproject(&pixel) {
            points.push(world_from_cam.point(&(ray.normalize() * distance)));
        }
    }
    points
}

fn sightings(view: &PosedCamera, points: &[Vector3<f64>]) -> Vec<Sighting> {
    let PosedCamera {
        camera,
        cam_from_world,
    } = view;
    let sighting = |(index, point): (usize, &Vector3<f64>)| {
        let seen = cam_from_world.point(point);
        camera.project_inside(&seen).map(|_| Sighting {
            point: index as u32,
            scale: camera.fx_px / seen.z,
        })
    };
    points.iter().enumerate().filter_map(sighting).collect()
}

/// A point in the views of two photos.
pub(crate) struct CommonPoint {
    pub place: Vector3<f64>,
    /// How much larger the first photo shows it.
    pub scale: f64,
}

/// What two photos show.
pub(crate) struct Overlap {
    pub points: Vec<CommonPoint>,
    /// Their share of the points of the photo with fewer.
    pub share: f64,
}

impl Overlap {
    /// `a`, `b`: sorted by point.
    fn new(points: &[Vector3<f64>], [a, b]: [&[Sighting]; 2]) -> Self {
        let (mut both, mut j) = (Vec::new(), 0);
        for one in a {
            while j < b.len() && b[j].point < one.point {
                j += 1;
            }
            if j < b.len() && b[j].point == one.point {
                both.push(CommonPoint {
                    place: points[one.point as usize],
                    scale: one.scale / b[j].scale,
                });
            }
        }
        Self {
            share: both.len() as f64 / a.len().min(b.len()).max(1) as f64,
            points: both,
        }
    }
}
