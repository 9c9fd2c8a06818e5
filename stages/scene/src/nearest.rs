//! How far a photo is from the photos that a field is trained on, and whether these show what it shows.

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::places::{PosedPhoto, place};
use crate::reach::{Posed, reach, shows};
use crate::{Camera, Point, Scene};

/// Sparse points of a photo that are looked for in the others, at most.
const MOST_POINTS: usize = 64;
/// With fewer, points at the typical distance replace them: a grid of this many a side.
const ENOUGH_POINTS: usize = 16;
const GRID: u32 = 8;
/// Cosine of the largest angle at a point between two photos for one to cover what the other shows: 30 degrees.
const COVERS: f64 = 0.866_025_403_784_438_6;
/// A photo extrapolates if more than this share of its points is covered by no other.
const EXTRAPOLATES: f64 = 0.5;

/// The nearest photo among those trained on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Nearest {
    /// Id of the photo nearest by position and direction together, by the measure that separates places (`hold = "place"`).
    pub id: String,
    /// Distance of the two cameras, world units.
    pub distance: f64,
    /// The same in metres, where the scene has a scale.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distance_m: Option<f64>,
    /// Angle between their optical axes, degrees.
    pub angle_deg: f64,
    /// Share of what the photo shows that no photo trained on shows from within 30 degrees of its direction, in [0, 1].
    pub uncovered_share: f64,
    /// Whether that is more than half: the photo looks where no photo trained on does.
    pub extrapolates: bool,
}

/// The photos that a field is trained on, to measure how far others are from them.
#[derive(Debug)]
pub struct TrainedPhotos<'a> {
    photos: Vec<PosedPhoto<'a>>,
    points: &'a [Point],
    metres_per_unit: Option<f64>,
    /// Typical distance from a camera to what it shows, world units.
    reach: f64,
}

impl<'a> TrainedPhotos<'a> {
    /// Takes the photos of a scene that a field is trained on.
    pub fn new(scene: &'a Scene, photos: Vec<PosedPhoto<'a>>) -> Self {
        let cameras: Vec<Posed<'_>> = photos.iter().map(PosedPhoto::posed).collect();
        Self {
            reach: reach(&cameras, &scene.points),
            points: &scene.points,
            metres_per_unit: scene.metres_per_unit,
            photos,
        }
    }

    /// Returns how far a photo is from them. `None` without any, and for one of them.
    ///
    /// The photo shows up to 64 of the sparse points in its frame. If these are fewer than 16, a grid of 64 points at the typical distance
    /// replaces them. Occlusion is ignored.
    pub fn nearest(&self, photo: PosedPhoto<'_>) -> Option<Nearest> {
        if self.photos.iter().any(|other| other.id == photo.id) {
            return None;
        }
        let own = place(photo.cam_from_world, self.reach);
        let apart = |other: &&PosedPhoto<'_>| (place(other.cam_from_world, self.reach) - own).norm_squared();
        let nearest = self.photos.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)))?;
        let distance = (nearest.cam_from_world.centre() - photo.cam_from_world.centre()).norm();
        let [own, other] = [photo, *nearest].map(|photo| photo.cam_from_world.rotation.row(2).transpose());
        let uncovered_share = self.uncovered_share(photo);
        Some(Nearest {
            id: nearest.id.to_owned(),
            distance,
            distance_m: self.metres_per_unit.map(|metres| distance * metres),
            angle_deg: own.angle(&other).to_degrees(),
            uncovered_share,
            extrapolates: uncovered_share > EXTRAPOLATES,
        })
    }

    fn uncovered_share(&self, photo: PosedPhoto<'_>) -> f64 {
        let points = self.shown(photo);
        let centre = photo.cam_from_world.centre();
        let is_covered =
            |point: &&Vector3<f64>| self.photos.iter().any(|other| covers(other, &centre, point));
        let covered = points.iter().filter(is_covered).count();
        1.0 - covered as f64 / points.len().max(1) as f64
    }

    /// Returns points of the world that a photo shows.
    fn shown(&self, photo: PosedPhoto<'_>) -> Vec<Vector3<f64>> {
        let all = self.points.iter().map(|point| Vector3::from(point.position));
        let found: Vec<_> = all.filter(|point| shows(photo.posed(), point)).collect();
        if found.len() < ENOUGH_POINTS {
            return grid(photo, self.reach);
        }
        let stride = found.len().div_ceil(MOST_POINTS);
        found.into_iter().step_by(stride).collect()
    }
}

/// Returns whether a photo shows a point from nearly the direction in which it is seen from `centre`.
fn covers(photo: &PosedPhoto<'_>, centre: &Vector3<f64>, point: &Vector3<f64>) -> bool {
    let (own, other) = (point - centre, point - photo.cam_from_world.centre());
    own.dot(&other) >= COVERS * own.norm() * other.norm() && shows(photo.posed(), point)
}

/// Returns the points at one distance behind the middles of the fields of a grid over the photo.
fn grid(photo: PosedPhoto<'_>, distance: f64) -> Vec<Vector3<f64>> {
    let world_from_cam = photo.cam_from_world.inverse();
    let at = |index: u32, side: u32| (f64::from(index) + 0.5) / f64::from(GRID) * f64::from(side);
    let Camera { width, height, .. } = *photo.camera;
    let pixels = (0..GRID).flat_map(|row| (0..GRID).map(move |column| (column, row)));
    let rays = pixels.filter_map(|(column, row)| {
        photo
            .camera
            .unproject(&Vector2::new(at(column, width), at(row, height)))
    });
    rays.map(|ray| world_from_cam.point(&(ray.normalize() * distance)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Frame, Pose};

    /// A camera on a circle of radius 3 around the origin, looking at it.
    fn frame(id: &str, turn: f64) -> Frame {
        let (sin, cos) = (turn * std::f64::consts::TAU).sin_cos();
        Frame {
            id: id.to_owned(),
            file: format!("{id}.png"),
            image: marf_cache::Digest::from_content(b""),
            camera: Camera::pinhole(40, 30, 40.0),
            cam_from_world: Pose::looking_at(
                Vector3::new(3.0 * cos, 3.0 * sin, 0.0),
                Vector3::zeros(),
                -Vector3::z(),
            ),
            held_out: false,
            mask: None,
            error_px: None,
        }
    }

    fn scene(points: u32) -> Scene {
        let position = |index: u32| {
            [
                f64::from(index % 8) / 8.0 - 0.5,
                f64::from(index / 8) / 8.0 - 0.5,
                0.1,
            ]
        };
        let point = |index: u32| Point {
            position: position(index),
            color: None,
            views: 2,
        };
        Scene {
            points: (0..points).map(point).collect(),
            metres_per_unit: Some(2.0),
            ..Scene::default()
        }
    }

    fn found(points: u32, trained: &[f64], turn: f64) -> Option<Nearest> {
        let scene = scene(points);
        let frames: Vec<Frame> = (0..)
            .zip(trained)
            .map(|(index, turn)| frame(&format!("{index:03}"), *turn))
            .collect();
        let photos = frames.iter().map(PosedPhoto::from).collect();
        TrainedPhotos::new(&scene, photos).nearest((&frame("own", turn)).into())
    }

    #[test]
    fn the_nearest_photo_is_named_with_distance_and_angle() {
        for points in [0, 64] {
            let nearest = found(points, &[0.5, 0.25, 0.0], 0.02).unwrap();
            assert_eq!(nearest.id, "002");
            // Chord of 0.02 turns, 7.2 degrees, on a circle of radius 3.
            assert!(
                (nearest.distance - 6.0 * 3.6_f64.to_radians().sin()).abs() < 1e-9,
                "{nearest:?}"
            );
            assert_eq!(nearest.distance_m, Some(2.0 * nearest.distance));
            assert!((nearest.angle_deg - 7.2).abs() < 1e-6, "{nearest:?}");
            assert!(!nearest.extrapolates, "{nearest:?}");
        }
    }

    #[test]
    fn a_photo_beside_it_that_looks_elsewhere_is_not_the_nearest() {
        let scene = scene(64);
        let (own, aside) = (frame("own", 0.0), frame("aside", 0.04));
        let mut away = frame("away", 0.01);
        away.cam_from_world = Pose::looking_at(
            away.cam_from_world.centre(),
            Vector3::new(9.0, 9.0, 0.0),
            -Vector3::z(),
        );
        let trained = TrainedPhotos::new(&scene, vec![(&away).into(), (&aside).into()]);
        assert_eq!(trained.nearest((&own).into()).unwrap().id, "aside");
    }

    #[test]
    fn a_photo_from_another_side_extrapolates_although_its_points_are_in_other_frames() {
        for points in [0, 64] {
            for (turn, extrapolates) in [(0.0, false), (0.06, false), (0.25, true), (0.5, true)] {
                let nearest = found(points, &[0.0, 0.01], turn).unwrap();
                assert_eq!(
                    nearest.extrapolates, extrapolates,
                    "{points} points, {turn} turns: {nearest:?}"
                );
            }
        }
    }

    #[test]
    fn without_a_photo_nothing_is_near_and_a_twin_is_at_distance_zero() {
        assert_eq!(found(64, &[], 0.0), None);
        let (scene, own) = (scene(64), frame("own", 0.0));
        let trained = TrainedPhotos::new(&scene, vec![(&own).into()]);
        assert_eq!(trained.nearest((&own).into()), None, "it is trained on");
        let twin = found(64, &[0.0], 0.0).unwrap();
        assert_eq!((twin.distance, twin.uncovered_share), (0.0, 0.0));
    }
}
