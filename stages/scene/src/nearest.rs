//! How far a photo is from the photos that a field is trained on, and whether these show what it shows.

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::coverage::{Coverage, Observer};
use crate::places::{PosedPhoto, place};
use crate::{Camera, Pose, Scene, typical_distance};

/// Pixels of a photo that are looked for in the others, at most.
const MOST_RAYS: usize = 256;
/// Largest angle at a point between two photos for one to cover what the other shows, degrees.
const COVERS_DEG: f64 = 30.0;
/// Least share of the way to a surface that photos must have looked through. Behind space that none of them saw, a surface may be hidden.
/// On an orbit with a photo every 20 degrees it is a third.
const LOOKED_THROUGH: f64 = 0.25;
/// A photo extrapolates if more than this share of its pixels is covered by no other.
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
    /// Share of what the photo shows that no photo trained on shows from within 30 degrees of its direction, in [0, 1]. What a nearer
    /// surface of the field hides from a photo, that photo does not show.
    pub uncovered_share: f64,
    /// Whether that is more than half: the photo looks where no photo trained on does.
    pub extrapolates: bool,
}

/// A photo with the distances of a field's surfaces at its pixels.
#[derive(Debug, Clone)]
pub struct DepthView {
    /// Its camera, at any working size.
    pub camera: Camera,
    /// Its pose.
    pub cam_from_world: Pose,
    /// Distance along the ray of each pixel, `[height * width]`, world units. Infinite where the ray meets nothing, NaN where a mask hides
    /// the pixel.
    pub distance: Vec<f32>,
}

impl DepthView {
    /// Returns up to 256 rays, unit vectors of the world, with the distance that each goes. Pixels are evenly spaced.
    fn rays(&self) -> Vec<(Vector3<f64>, f64)> {
        let world_from_cam = self.cam_from_world.inverse();
        let at = |index: usize| index as f64 + 0.5;
        let width = self.camera.width as usize;
        let ray = |pixel: usize| {
            let distance = f64::from(self.distance[pixel]);
            let place = Vector2::new(at(pixel % width), at(pixel / width));
            let ray = self.camera.unproject(&place).filter(|_| distance > 0.0)?;
            Some((world_from_cam.direction(&ray.normalize()), distance))
        };
        let stride = self.distance.len().div_ceil(MOST_RAYS).max(1);
        (0..self.distance.len()).step_by(stride).filter_map(ray).collect()
    }
}

/// The photos that a field is trained on, to measure how far others are from them.
#[derive(Debug)]
pub struct TrainedPhotos<'a> {
    photos: Vec<PosedPhoto<'a>>,
    observers: Vec<Observer>,
    metres_per_unit: Option<f64>,
    /// Typical distance from a camera to what it shows, world units.
    reach: f64,
}

impl<'a> TrainedPhotos<'a> {
    /// Takes the photos of a scene that a field is trained on, with the field's distances in each.
    ///
    /// # Panics
    /// If a view has not a distance for every pixel: a slip of the program.
    pub fn new(scene: &Scene, photos: Vec<PosedPhoto<'a>>, views: &[DepthView]) -> Self {
        let observer = |view: &DepthView| Observer::new(view.camera, view.cam_from_world, &view.distance);
        Self {
            reach: typical_distance(&photos, &scene.points),
            observers: views.iter().map(observer).collect(),
            metres_per_unit: scene.metres_per_unit,
            photos,
        }
    }

    /// Returns how far a photo is from them. `None` without any, and for one of them. `view` has the field's distances in the photo.
    pub fn nearest(&self, photo: PosedPhoto<'_>, view: &DepthView) -> Option<Nearest> {
        if self.photos.iter().any(|other| other.id == photo.id) {
            return None;
        }
        let own = place(photo.cam_from_world, self.reach);
        let apart = |other: &&PosedPhoto<'_>| (place(other.cam_from_world, self.reach) - own).norm_squared();
        let nearest = self.photos.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)))?;
        let distance = (nearest.cam_from_world.centre() - photo.cam_from_world.centre()).norm();
        let [own, other] = [photo, *nearest].map(|photo| photo.cam_from_world.rotation.row(2).transpose());
        let uncovered_share = self.uncovered_share(view);
        Some(Nearest {
            id: nearest.id.to_owned(),
            distance,
            distance_m: self.metres_per_unit.map(|metres| distance * metres),
            angle_deg: own.angle(&other).to_degrees(),
            uncovered_share,
            extrapolates: uncovered_share > EXTRAPOLATES,
        })
    }

    fn uncovered_share(&self, view: &DepthView) -> f64 {
        let coverage = Coverage::from_viewpoint(&self.observers, &view.cam_from_world, self.reach);
        let rays = view.rays();
        let is_covered = |(ray, distance): &&(Vector3<f64>, f64)| is_covered(&coverage, ray, *distance);
        let uncovered = rays.len() - rays.iter().filter(is_covered).count();
        uncovered as f64 / rays.len().max(1) as f64
    }
}

/// Returns whether photos show what a ray meets at a distance from nearly its direction, or the sky along it, and at least a quarter of
/// the way to it.
fn is_covered(coverage: &Coverage<'_>, ray: &Vector3<f64>, distance: f64) -> bool {
    let is_shown = if distance.is_finite() {
        // The angle to the direction back to the eye is the one between both photos.
        coverage.surface(ray, distance, Some(&-ray)).incidence_deg <= COVERS_DEG
    } else {
        coverage.sky(ray).photos > 0
    };
    is_shown && coverage.looked_through(ray, distance) >= LOOKED_THROUGH
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Frame;

    /// A thing that hides what is behind it.
    #[derive(Clone, Copy)]
    enum Solid {
        /// A ball: its middle and radius.
        Ball(Vector3<f64>, f64),
        /// The plane x = 0.
        Wall,
    }

    impl Solid {
        /// Returns the distance at which a ray first meets it.
        fn hit(self, eye: &Vector3<f64>, ray: &Vector3<f64>) -> Option<f64> {
            let distance = match self {
                Self::Ball(middle, radius) => {
                    let (along, apart) = ((middle - eye).dot(ray), (middle - eye).norm_squared());
                    along - (radius * radius - (apart - along * along)).max(-1.0).sqrt()
                }
                Self::Wall => -eye.x / ray.x,
            };
            (distance > 0.0).then_some(distance)
        }
    }

    /// A camera on a circle of that radius around the origin, looking at it.
    fn at_radius(id: &str, turn: f64, radius: f64) -> Frame {
        let (sin, cos) = (turn * std::f64::consts::TAU).sin_cos();
        Frame {
            id: id.to_owned(),
            file: format!("{id}.png"),
            image: marf_cache::Digest::from_content(b""),
            camera: Camera::pinhole(40, 30, 80.0),
            cam_from_world: Pose::looking_at(
                Vector3::new(radius * cos, radius * sin, 0.0),
                Vector3::zeros(),
                -Vector3::z(),
            ),
            held_out: false,
            mask: None,
            error_px: None,
        }
    }

    fn frame(id: &str, turn: f64) -> Frame {
        at_radius(id, turn, 3.0)
    }

    fn view(frame: &Frame, solids: &[Solid]) -> DepthView {
        let Frame {
            camera,
            cam_from_world,
            ..
        } = frame;
        let (eye, world_from_cam) = (cam_from_world.centre(), cam_from_world.inverse());
        let distance = (0..camera.width * camera.height).map(|pixel| {
            let at = |index: u32| f64::from(index) + 0.5;
            let place = Vector2::new(at(pixel % camera.width), at(pixel / camera.width));
            let ray = world_from_cam.direction(&camera.unproject(&place).unwrap().normalize());
            let hits = solids.iter().filter_map(|solid| solid.hit(&eye, &ray));
            hits.fold(f64::INFINITY, f64::min) as f32
        });
        DepthView {
            camera: *camera,
            cam_from_world: *cam_from_world,
            distance: distance.collect(),
        }
    }

    /// Returns how far a photo is from those trained on, in a world of solids.
    fn nearest(trained: &[Frame], own: &Frame, solids: &[Solid]) -> Option<Nearest> {
        let scene = Scene {
            metres_per_unit: Some(2.0),
            ..Scene::default()
        };
        let views: Vec<DepthView> = trained.iter().map(|frame| view(frame, solids)).collect();
        let photos = trained.iter().map(PosedPhoto::from).collect();
        TrainedPhotos::new(&scene, photos, &views).nearest(own.into(), &view(own, solids))
    }

    /// A ball that fills every photo of the circle.
    const BALL: Solid = Solid::Ball(Vector3::new(0.0, 0.0, 0.0), 1.0);

    fn found(trained: &[f64], turn: f64) -> Option<Nearest> {
        let trained: Vec<Frame> = (0..)
            .zip(trained)
            .map(|(index, turn)| frame(&format!("{index:03}"), *turn))
            .collect();
        nearest(&trained, &frame("own", turn), &[BALL])
    }

    #[test]
    fn the_nearest_photo_is_named_with_distance_and_angle() {
        let nearest = found(&[0.5, 0.25, 0.0], 0.02).unwrap();
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

    #[test]
    fn a_photo_beside_it_that_looks_elsewhere_is_not_the_nearest() {
        let (own, aside, mut away) = (frame("own", 0.0), frame("aside", 0.04), frame("away", 0.01));
        away.cam_from_world = Pose::looking_at(
            away.cam_from_world.centre(),
            Vector3::new(9.0, 9.0, 0.0),
            -Vector3::z(),
        );
        assert_eq!(nearest(&[away, aside], &own, &[BALL]).unwrap().id, "aside");
    }

    #[test]
    fn a_photo_from_another_side_extrapolates_although_its_middle_is_in_other_frames() {
        for (turn, extrapolates) in [(0.0, false), (0.03, false), (0.25, true), (0.5, true)] {
            let nearest = found(&[0.0, 0.01], turn).unwrap();
            assert_eq!(nearest.extrapolates, extrapolates, "{turn} turns: {nearest:?}");
        }
    }

    #[test]
    fn without_a_photo_nothing_is_near_and_a_twin_is_at_distance_zero() {
        assert_eq!(found(&[], 0.0), None);
        let own = frame("own", 0.0);
        assert_eq!(
            nearest(std::slice::from_ref(&own), &own, &[BALL]),
            None,
            "it is trained on"
        );
        let twin = found(&[0.0], 0.0).unwrap();
        assert_eq!((twin.distance, twin.uncovered_share), (0.0, 0.0));
    }

    /// A wall is all that a photo shows. Two photos farther back look the same way, and a tree before them hides the wall from both.
    #[test]
    fn what_a_tree_hides_from_every_photo_is_not_covered_by_them() {
        let own = at_radius("own", 0.0, 4.0);
        let trained = [-0.005, 0.005].map(|turn| at_radius(&format!("{turn}"), turn, 8.0));
        let open = nearest(&trained, &own, &[Solid::Wall]).unwrap();
        assert_eq!(
            (open.uncovered_share, open.extrapolates),
            (0.0, false),
            "{open:?}"
        );
        let tree = Solid::Ball(Vector3::new(6.0, 0.0, 0.0), 1.5);
        let hidden = nearest(&trained, &own, &[Solid::Wall, tree]).unwrap();
        assert_eq!(
            (hidden.uncovered_share, hidden.extrapolates),
            (1.0, true),
            "{hidden:?}"
        );
    }

    /// A ball fills a photo. Other photos show its back, and beside it all of the wall behind that the photo would show without it.
    #[test]
    fn a_photo_filled_by_a_near_object_extrapolates_where_others_show_only_what_is_behind() {
        let own = at_radius("own", 0.0, 8.0);
        let mut trained = [at_radius("0", 0.0, 5.0), at_radius("1", 0.01, 5.0)];
        // Their frames hold all of the wall that the photo would show.
        trained
            .iter_mut()
            .for_each(|frame| frame.camera = Camera::pinhole(40, 30, 30.0));
        let open = nearest(&trained, &own, &[Solid::Wall]).unwrap();
        assert!(!open.extrapolates, "{open:?}");
        let near = Solid::Ball(Vector3::new(7.0, 0.0, 0.0), 0.9);
        let filled = nearest(&trained, &own, &[Solid::Wall, near]).unwrap();
        assert_eq!(
            (filled.uncovered_share, filled.extrapolates),
            (1.0, true),
            "{filled:?}"
        );
    }

    #[test]
    fn hidden_pixels_are_neither_looked_for_nor_shown() {
        let (own, other) = (frame("own", 0.0), frame("0", 0.01));
        let scene = Scene::default();
        let mut masked = view(&other, &[BALL]);
        masked.distance.fill(f32::NAN);
        let trained = TrainedPhotos::new(&scene, vec![(&other).into()], &[masked.clone()]);
        let share = |view: &DepthView| trained.nearest((&own).into(), view).unwrap().uncovered_share;
        assert_eq!(share(&view(&own, &[BALL])), 1.0);
        assert_eq!(share(&masked), 0.0, "it shows nothing, so nothing is uncovered");
    }
}
