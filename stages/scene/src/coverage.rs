//! What photos saw of a scene: which of them show a point, which show the sky in a direction, which space they looked through.

use nalgebra::Vector3;

use crate::places::{PosedPhoto, place};
use crate::{Camera, Pose};

/// A photo shows points up to this share of the distance behind the surface that it shows: depths of fields are as exact.
const BEHIND: f64 = 0.05;
/// Points along a ray at which photos are tested for having looked through them.
const PLACES: u32 = 12;
/// The nearest of these places, as a share of the distance to the surface or, of rays into the sky, of the typical distance.
const FROM: f64 = 0.25;
/// Factor from one place on a ray into the sky to the next: the last is at 22 typical distances.
const GROWTH: f64 = 1.5;

/// A photo, and how far it saw.
#[derive(Debug, Clone)]
pub struct Observer {
    camera: Camera,
    cam_from_world: Pose,
    centre: Vector3<f64>,
    /// Distance to the farthest surface around a pixel, `[height * width]`, world units. Infinite in the sky.
    distance: Vec<f32>,
    /// Error of a field's colour at each pixel, `[height * width]`, negative where it is unknown. Empty if it is unknown everywhere.
    error: Vec<f32>,
}

impl Observer {
    /// Takes a photo's camera, at any working size, with the distance along the ray of each of its pixels: `[height * width]`, world
    /// units, infinite where the ray meets nothing, NaN where a mask hides the pixel: there the photo shows nothing.
    ///
    /// # Panics
    /// If there is not a distance for every pixel: a slip of the program.
    pub fn new(camera: Camera, cam_from_world: Pose, distance: &[f32]) -> Self {
        let (width, height) = (camera.width as usize, camera.height as usize);
        assert_eq!(distance.len(), width * height, "a distance for every pixel");
        let farthest = |pixel: usize| {
            if distance[pixel].is_nan() {
                return 0.0;
            }
            let (column, row) = (pixel % width, pixel / width);
            let rows = row.saturating_sub(1)..(row + 2).min(height);
            let columns = column.saturating_sub(1)..(column + 2).min(width);
            let around = rows.flat_map(|row| distance[row * width..][columns.clone()].iter());
            around.copied().fold(0.0, f32::max)
        };
        Self {
            centre: cam_from_world.centre(),
            distance: (0..distance.len()).map(farthest).collect(),
            error: Vec::new(),
            camera,
            cam_from_world,
        }
    }

    /// Adds the error of a field at each pixel: `[height * width]`, in any unit, negative where it is unknown.
    ///
    /// # Panics
    /// If there is not an error for every pixel: a slip of the program.
    #[must_use]
    pub fn with_errors(self, error: Vec<f32>) -> Self {
        assert_eq!(error.len(), self.distance.len(), "an error for every pixel");
        Self { error, ..self }
    }

    /// Returns the pixel of a direction of the camera's frame, or `None` outside the photo.
    fn pixel(&self, direction: &Vector3<f64>) -> Option<usize> {
        let pixel = self.camera.project(direction)?;
        let (column, row) = (pixel.x.floor(), pixel.y.floor());
        let (width, height) = (f64::from(self.camera.width), f64::from(self.camera.height));
        let inside = column >= 0.0 && row >= 0.0 && column < width && row < height;
        inside.then(|| row as usize * self.camera.width as usize + column as usize)
    }

    /// Returns the pixel at which the photo shows a point, or something behind it.
    fn shows(&self, point: &Vector3<f64>) -> Option<usize> {
        let pixel = self.pixel(&self.cam_from_world.point(point))?;
        let saw = f64::from(self.distance[pixel]);
        ((point - self.centre).norm() <= saw * (1.0 + BEHIND)).then_some(pixel)
    }

    /// Returns the pixel at which the photo shows the sky in a direction of the world.
    fn shows_sky(&self, direction: &Vector3<f64>) -> Option<usize> {
        let pixel = self.pixel(&self.cam_from_world.direction(direction))?;
        (self.distance[pixel] == f32::INFINITY).then_some(pixel)
    }

    fn squared_error(&self, pixel: usize) -> Option<f64> {
        let error = self.error.get(pixel).filter(|error| **error >= 0.0);
        error.map(|error| f64::from(*error) * f64::from(*error))
    }
}

/// Root of a weighted mean of squares that is being summed.
#[derive(Default)]
struct RootMeanSquare {
    sum: f64,
    weight: f64,
}

impl RootMeanSquare {
    fn add(&mut self, square: Option<f64>, weight: f64) {
        if let Some(square) = square {
            self.sum += weight * square;
            self.weight += weight;
        }
    }

    fn root(&self) -> Option<f64> {
        (self.weight > 0.0).then(|| (self.sum / self.weight).sqrt())
    }
}

/// Photos sorted for one viewpoint, the nearest first.
#[derive(Debug)]
pub struct Coverage<'a> {
    observers: Vec<&'a Observer>,
    eye: Vector3<f64>,
    reach: f64,
}

/// The surface that a ray meets, as photos saw it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceSeen {
    /// Photos that show it.
    pub photos: u32,
    /// Distance of the nearest of them, world units. Infinite without any.
    pub distance: f64,
    /// Least angle between its normal and the direction to a photo, degrees: 0 from straight above, 180 without any.
    pub incidence_deg: f64,
    /// Root mean square error of a field there, over the photos that show it, weighted by their distances. `None` if no such photo knows
    /// its error.
    pub error: Option<f64>,
}

/// The sky in a direction, as photos saw it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SkySeen {
    /// Photos that show it.
    pub photos: u32,
    /// As [`SurfaceSeen::error`].
    pub error: Option<f64>,
}

impl<'a> Coverage<'a> {
    /// Sorts the photos for the viewpoint of a camera. `reach` is the typical distance to what photos show, world units, above 0.
    pub fn from_viewpoint(observers: &'a [Observer], cam_from_world: &Pose, reach: f64) -> Self {
        let own = place(cam_from_world, reach);
        let apart = |observer: &Observer| (place(&observer.cam_from_world, reach) - own).norm_squared();
        let mut sorted: Vec<(f64, &Observer)> = observers
            .iter()
            .map(|observer| (apart(observer), observer))
            .collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self {
            observers: sorted.into_iter().map(|(_, observer)| observer).collect(),
            eye: cam_from_world.centre(),
            reach,
        }
    }

    /// Returns how photos saw the surface at a distance (world units, above 0) along a ray (a unit vector of the world). The normal has any
    /// length. Without it the angle is 180 degrees.
    pub fn surface(&self, ray: &Vector3<f64>, distance: f64, normal: Option<&Vector3<f64>>) -> SurfaceSeen {
        seen(
            self.observers.iter().copied(),
            &(self.eye + ray * distance),
            normal,
            Some(distance),
        )
    }

    /// Returns how photos saw the sky in a direction (a unit vector of the world).
    pub fn sky(&self, ray: &Vector3<f64>) -> SkySeen {
        let (mut photos, mut error) = (0, RootMeanSquare::default());
        for observer in &self.observers {
            if let Some(pixel) = observer.shows_sky(ray) {
                photos += 1;
                error.add(observer.squared_error(pixel), 1.0);
            }
        }
        SkySeen {
            photos,
            error: error.root(),
        }
    }

    /// Returns the share of the way along a ray that at least one photo looked through, in [0, 1]: from a quarter of `distance` on to the
    /// surface there, or, of a ray into the sky (infinite), from a quarter of the typical distance to 22 of it.
    ///
    /// Nearer points are not tested: a camera is in space that no other sees.
    pub fn looked_through(&self, ray: &Vector3<f64>, distance: f64) -> f64 {
        let step = |index: u32| FROM + (1.0 - FROM) * f64::from(index) / f64::from(PLACES);
        let far = |index: u32| FROM * GROWTH.powi(index as i32);
        let seen = (0..PLACES).filter(|index| {
            let along = if distance.is_finite() {
                step(*index) * distance
            } else {
                far(*index) * self.reach
            };
            let point = self.eye + ray * along;
            self.observers
                .iter()
                .any(|observer| observer.shows(&point).is_some())
        });
        seen.count() as f64 / f64::from(PLACES)
    }
}

/// Returns how photos saw a point of the world on a surface. The normal has any length. Without it the angle is 180 degrees.
pub fn seen_at(observers: &[Observer], point: &Vector3<f64>, normal: Option<&Vector3<f64>>) -> SurfaceSeen {
    seen(observers.iter(), point, normal, None)
}

/// Returns the weight of a photo's error at that distance of a point for an eye at another: the cube of the ratio of the nearer to the
/// farther. A photo from twice as far shows less detail, so its error says little about the error for the eye.
fn likeness(eye_distance: Option<f64>, distance: f64) -> f64 {
    let Some(eye_distance) = eye_distance else {
        return 1.0;
    };
    let ratio = eye_distance.min(distance) / eye_distance.max(distance);
    ratio * ratio * ratio
}

fn seen<'o>(
    observers: impl Iterator<Item = &'o Observer>,
    point: &Vector3<f64>,
    normal: Option<&Vector3<f64>>,
    eye_distance: Option<f64>,
) -> SurfaceSeen {
    let mut seen = SurfaceSeen {
        photos: 0,
        distance: f64::INFINITY,
        incidence_deg: 180.0,
        error: None,
    };
    let mut error = RootMeanSquare::default();
    for observer in observers {
        let Some(pixel) = observer.shows(point) else {
            continue;
        };
        let back = observer.centre - point;
        let distance = back.norm();
        error.add(observer.squared_error(pixel), likeness(eye_distance, distance));
        seen.photos += 1;
        seen.distance = seen.distance.min(distance);
        if let Some(normal) = normal {
            seen.incidence_deg = seen.incidence_deg.min(normal.angle(&back).to_degrees());
        }
    }
    seen.error = error.root();
    seen
}

/// Returns the typical distance from the photos to what they show, world units. It is the scale by which places are separated.
pub fn typical_distance(photos: &[PosedPhoto<'_>], points: &[crate::Point]) -> f64 {
    let cameras: Vec<_> = photos.iter().map(PosedPhoto::posed).collect();
    crate::reach::reach(&cameras, points)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: u32 = 41;

    /// A camera at `x` on a line, 10 units before a wall in the plane z = 10, which is 4 high: above is sky.
    fn observer(x: f64) -> Observer {
        observer_before(x, |_| false)
    }

    /// The same with a box between the wall and the camera, at z = 5, in the columns that `blocked` names.
    fn observer_before(x: f64, blocked: impl Fn(u32) -> bool) -> Observer {
        let camera = Camera::pinhole(SIDE, SIDE, f64::from(SIDE));
        let cam_from_world = Pose {
            translation: Vector3::new(-x, 0.0, 0.0),
            ..Pose::identity()
        };
        let distance: Vec<f32> = (0..SIDE * SIDE)
            .map(|pixel| {
                let at = |place: u32| f64::from(place) + 0.5;
                let ray = camera
                    .unproject(&nalgebra::Vector2::new(at(pixel % SIDE), at(pixel / SIDE)))
                    .unwrap();
                let z = if blocked(pixel % SIDE) { 5.0 } else { 10.0 };
                if ray.y * 10.0 < -2.0 {
                    f32::INFINITY
                } else {
                    (ray.norm() * z) as f32
                }
            })
            .collect();
        Observer::new(camera, cam_from_world, &distance)
    }

    fn from_origin(observers: &[Observer]) -> Coverage<'_> {
        Coverage::from_viewpoint(observers, &Pose::identity(), 10.0)
    }

    #[test]
    fn photos_that_show_a_point_of_the_wall_are_counted_with_distance_and_angle() {
        let observers = [observer(-2.0), observer(0.0), observer(100.0)];
        let coverage = from_origin(&observers);
        let normal = -Vector3::z();
        let seen = coverage.surface(&Vector3::z(), 10.0, Some(&normal));
        assert_eq!((seen.photos, seen.distance, seen.incidence_deg), (2, 10.0, 0.0));
        let aside = from_origin(&observers[..1]).surface(&Vector3::z(), 10.0, Some(&normal));
        assert!((aside.distance - 104.0_f64.sqrt()).abs() < 1e-12, "{aside:?}");
        assert!(
            (aside.incidence_deg - (0.2_f64).atan().to_degrees()).abs() < 1e-9,
            "{aside:?}"
        );
        assert_eq!(coverage.surface(&Vector3::z(), 10.0, None).incidence_deg, 180.0);
    }

    #[test]
    fn what_lies_behind_a_surface_is_not_shown_but_for_the_tolerance() {
        let observers = [observer(0.0)];
        let coverage = from_origin(&observers);
        let photos = |distance: f64| coverage.surface(&Vector3::z(), distance, None).photos;
        assert_eq!(
            [photos(1.0), photos(10.4), photos(10.7), photos(20.0)],
            [1, 1, 0, 0]
        );
        assert_eq!(from_origin(&[]).surface(&Vector3::z(), 10.0, None).photos, 0);
    }

    #[test]
    fn the_sky_counts_where_a_photo_shows_it() {
        let observers = [observer(0.0), observer(3.0)];
        let coverage = from_origin(&observers);
        let up = Vector3::new(0.0, -0.4, 1.0).normalize();
        assert_eq!(
            [up, Vector3::z(), -up].map(|ray| coverage.sky(&ray).photos),
            [2, 0, 0]
        );
    }

    #[test]
    fn a_way_counts_as_far_as_photos_looked_through_it() {
        let observers = [observer(0.0)];
        let coverage = from_origin(&observers);
        assert_eq!(coverage.looked_through(&Vector3::z(), 10.0), 1.0);
        // Of 12 places from 5 to 18.75 in steps of 1.25, those up to 10.5 are seen.
        assert_eq!(coverage.looked_through(&Vector3::z(), 20.0), 5.0 / 12.0);
        assert_eq!(coverage.looked_through(&-Vector3::z(), 10.0), 0.0);
        let up = Vector3::new(0.0, -0.4, 1.0).normalize();
        assert_eq!(coverage.looked_through(&up, f64::INFINITY), 1.0);
        // Behind a box that fills the photo nothing is known from 5.25 on.
        let blocked = [observer_before(0.0, |_| true)];
        let hidden = from_origin(&blocked).looked_through(&Vector3::z(), 10.0);
        assert!((0.3..0.5).contains(&hidden), "{hidden}");
    }

    #[test]
    fn errors_are_the_root_mean_square_of_the_photos_that_show_it_and_know_them() {
        let with = |x: f64, error: f32| observer(x).with_errors(vec![error; (SIDE * SIDE) as usize]);
        let observers = [
            with(0.0, 3.0),
            with(0.0, 4.0),
            with(2.0, -1.0),
            with(100.0, 50.0),
            observer(0.5),
        ];
        let coverage = from_origin(&observers);
        let (wall, up) = (Vector3::z(), Vector3::new(0.0, -0.4, 1.0).normalize());
        let expected = Some(12.5_f64.sqrt());
        let seen = coverage.surface(&wall, 10.0, None);
        assert_eq!((seen.photos, seen.error), (4, expected));
        // The sky is at no distance: the one far away shows it, too.
        let sky = coverage.sky(&up);
        assert_eq!((sky.photos, sky.error), (5, Some((2525.0_f64 / 3.0).sqrt())));
        assert_eq!(
            from_origin(&observers[4..]).surface(&wall, 10.0, None).error,
            None
        );
        assert_eq!(coverage.surface(&wall, 20.0, None).error, None, "behind the wall");
    }

    #[test]
    fn a_photo_from_twice_or_half_as_far_counts_an_eighth_and_one_from_as_far_in_full() {
        for (eye, photo, expected) in [(2.0, 4.0, 0.125), (4.0, 2.0, 0.125), (3.0, 3.0, 1.0)] {
            assert_eq!(likeness(Some(eye), photo), expected, "{eye} {photo}");
        }
        assert_eq!(likeness(None, 7.0), 1.0);
    }

    /// A photo that looks along z from `z` on the axis and sees 1,000 units far, with this error everywhere.
    fn on_axis(z: f64, error: f32) -> Observer {
        let pose = Pose {
            translation: Vector3::new(0.0, 0.0, -z),
            ..Pose::identity()
        };
        let pixels = (SIDE * SIDE) as usize;
        let camera = Camera::pinhole(SIDE, SIDE, f64::from(SIDE));
        Observer::new(camera, pose, &vec![1e3; pixels]).with_errors(vec![error; pixels])
    }

    /// The eye is 10 from the point, the photos 10, 20 and 5: weights 1, 1/8 and 1/8, so (9 + 25/8 + 49/8) / (5/4) = 14.6.
    #[test]
    fn errors_of_photos_from_other_distances_than_the_eye_weigh_less_in_the_mean() {
        let observers = [on_axis(0.0, 3.0), on_axis(-10.0, 5.0), on_axis(5.0, 7.0)];
        let (ahead, point) = (Vector3::z(), 10.0 * Vector3::z());
        let error =
            |observers: &[Observer]| from_origin(observers).surface(&ahead, 10.0, None).error.unwrap();
        assert!(
            (error(&observers) - 14.6_f64.sqrt()).abs() < 1e-12,
            "{}",
            error(&observers)
        );
        // Without an eye all count alike.
        let alike = seen_at(&observers, &point, None);
        assert!(
            (alike.error.unwrap() - (83.0_f64 / 3.0).sqrt()).abs() < 1e-12,
            "{alike:?}"
        );
        // Weights are those of a mean: a single photo gives its own error, however far it is.
        for z in [-10.0, 5.0, -900.0, 9.999] {
            let alone = error(&[on_axis(z, 5.0)]);
            assert!((alone - 5.0).abs() < 1e-12, "{z}: {alone}");
        }
        // One that does not know its error takes no part, and is counted all the same.
        let unknown = [on_axis(0.0, -1.0), on_axis(-10.0, 5.0)];
        let seen = from_origin(&unknown).surface(&ahead, 10.0, None);
        assert_eq!((seen.photos, seen.error), (2, Some(5.0)));
    }

    #[test]
    fn what_a_mask_hides_was_not_seen() {
        let camera = Camera::pinhole(SIDE, SIDE, f64::from(SIDE));
        let mut distance = vec![f32::INFINITY; (SIDE * SIDE) as usize];
        distance[(SIDE / 2 * SIDE + SIDE / 2) as usize] = f32::NAN;
        let observers = [Observer::new(camera, Pose::identity(), &distance)];
        let coverage = from_origin(&observers);
        let aside = Vector3::new(0.1, 0.0, 1.0).normalize();
        assert_eq!([Vector3::z(), aside].map(|ray| coverage.sky(&ray).photos), [0, 1]);
        assert_eq!(coverage.surface(&Vector3::z(), 1.0, None).photos, 0);
    }

    #[test]
    fn edges_take_the_farther_surface() {
        // The box ends between columns 20 and 21. The ray straight on goes through column 20.
        let observers = [observer_before(0.0, |column| column <= 20)];
        let coverage = from_origin(&observers);
        assert_eq!(coverage.surface(&Vector3::z(), 10.0, None).photos, 1);
        let left = Vector3::new(-0.1, 0.0, 1.0).normalize();
        assert_eq!(coverage.surface(&left, 10.0, None).photos, 0);
    }
}
