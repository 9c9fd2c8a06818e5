use marf_cache::{Digest, digest_of};
use marf_field::Field;
use marf_scene::{Camera, Coverage, Observer, PosedPhoto, Scene, path::Viewpoint, typical_distance};
use marf_stage::StageError;
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use super::intervals::locally_within;
use super::maps::{Surfaces, Visibility, gray};
use crate::{
    checkpoint::Journal,
    depth_views::{MIN_OPACITY, surface_distances},
    error::field_failed,
    photos::PhotoReader,
    split::NamedFrame,
};

/// Longest side at which depths of the photos are rendered, pixels: what hides a point is known to one of these.
const SIDE_PX: u32 = 160;
/// Least share of a pixel that matter, or sky, must have for its visibility to count.
const LEAST_SHARE: f32 = 0.02;
/// Rows and columns on each side of a pixel of a photo whose errors are averaged with its own. Where only two or three photos show a point,
/// single errors say little.
const AROUND: usize = 1;
/// Neighbouring pixels farther apart in depth than this share are not one surface.
const ONE_SURFACE: f64 = 0.2;

/// The photos that a field is trained on, with the depths of the field at their views, and how far its colours are from theirs.
pub(crate) struct Witnesses {
    observers: Vec<Observer>,
    /// Typical distance to what photos show, world units.
    reach: f64,
}

impl Witnesses {
    /// Renders the photos' views with a field. `of` identifies the node and its field.
    pub fn new(
        of: Digest,
        field: &Field,
        photos: &PhotoReader<'_>,
        frames: &[NamedFrame<'_>],
        scene: &Scene,
    ) -> Result<Self, StageError> {
        let ctx = photos.ctx;
        let mut journal = Journal::new(ctx, "witnesses", digest_of(&(of, "witnesses")));
        let observers = frames.iter().enumerate().map(|(index, named)| {
            let note = format!("depths of photo {}", named.name);
            ctx.progress.at(index as u64, frames.len() as u64, &note);
            let sample = Sample::new(&named.frame.camera.box_reduced(photos.scale));
            let pixels = sample.camera.width as usize * sample.camera.height as usize;
            let mut values: Vec<f32> = journal.piece_of(
                |values: &Vec<f32>| values.len() == 2 * pixels,
                || sample.distances_and_errors(field, photos, named),
            )?;
            let (distance, error) = values.split_at_mut(pixels);
            let hidden = photos.hidden_at(named.frame, photos.scale * sample.every)?;
            for (pixel, _) in (0..).zip(hidden).filter(|(_, hidden)| *hidden) {
                (distance[pixel], error[pixel]) = (f32::NAN, -1.0);
            }
            let observer = Observer::new(sample.camera, named.frame.cam_from_world, distance);
            Ok(observer.with_errors(locally_within(error, sample.camera.width, AROUND)))
        });
        let observers = observers.collect::<Result<_, StageError>>()?;
        journal.end();
        let photos: Vec<PosedPhoto<'_>> = frames.iter().map(|named| named.frame.into()).collect();
        Ok(Self {
            observers,
            reach: typical_distance(&photos, &scene.points),
        })
    }

    /// Returns the visibility of each pixel of a view with these depths and opacities.
    pub fn visibilities(&self, place: &Viewpoint, surfaces: &Surfaces) -> Vec<Visibility> {
        let coverage = Coverage::from_viewpoint(&self.observers, &place.cam_from_world, self.reach);
        let rays = rays(place);
        let width = place.camera.width as usize;
        let visibility = |pixel: usize| {
            let Some(ray) = rays[pixel] else { return UNSEEN };
            let normal = || normal(&rays, surfaces, pixel, width);
            visibility(
                &coverage,
                &ray,
                surfaces.depth[pixel],
                surfaces.opacity[pixel],
                &normal,
            )
        };
        (0..rays.len()).into_par_iter().map(visibility).collect()
    }
}

/// No photo saw any of it.
const UNSEEN: Visibility = Visibility {
    surface: 0.0,
    sky: 0.0,
    photos: 0.0,
    photo_distance: -1.0,
    incidence_deg: -1.0,
    residual: 0.0,
};

/// Some of the pixels of a photo, as those of a smaller one. Their errors are those of single pixels. A shrunk photo would lack what is
/// finer than its pixels.
struct Sample {
    /// Distance of the sampled columns and rows, pixels of the photo.
    every: u32,
    /// Whose pixels see what those of the photo see.
    camera: Camera,
}

impl Sample {
    /// Takes the pixels in the middle of blocks of a photo with that camera.
    fn new(camera: &Camera) -> Self {
        let longest = camera.width.max(camera.height);
        let shortest = camera.width.min(camera.height).max(1);
        let every = longest.div_ceil(SIDE_PX).clamp(1, shortest);
        let shrunk = camera.box_reduced(every);
        // The pixel of a block is right and below of its middle by half a pixel where the block has an even side.
        let moved = 0.5 - (f64::from(every / 2) + 0.5) / f64::from(every);
        let camera = Camera {
            cx_px: shrunk.cx_px + moved,
            cy_px: shrunk.cy_px + moved,
            ..shrunk
        };
        Self { every, camera }
    }

    /// Returns the distances that a field shows at the pixels, infinite in the sky, and after them how far its gray is from the photo's.
    fn distances_and_errors(
        &self,
        field: &Field,
        photos: &PhotoReader<'_>,
        named: &NamedFrame<'_>,
    ) -> Result<Vec<f32>, StageError> {
        let photo = photos.read(named.frame)?.without_falloff().image;
        let render = field.render(&self.camera, &named.frame.cam_from_world);
        let render = render.map_err(field_failed)?;
        let place = |along: u32| along * self.every + self.every / 2;
        let errors = (0_u32..).zip(&render.rgb).map(|(pixel, rgb)| {
            let (column, row) = (pixel % self.camera.width, pixel / self.camera.width);
            let photo = photo.at(place(column), place(row));
            let photo = gray(&photo.map(|value| f32::from(value) / 255.0));
            (gray(rgb) - photo).abs() as f32
        });
        Ok(surface_distances(&render).chain(errors).collect())
    }
}

/// Returns the unit vector of the world along every pixel of a view. `None` where the lens has no ray for it.
fn rays(place: &Viewpoint) -> Vec<Option<Vector3<f64>>> {
    let (camera, world_from_cam) = (&place.camera, place.cam_from_world.inverse());
    let at = |place: u32| f64::from(place) + 0.5;
    let pixels = (0..camera.height).flat_map(|row| (0..camera.width).map(move |column| (column, row)));
    let rays = pixels.map(|(column, row)| {
        let ray = camera.unproject(&Vector2::new(at(column), at(row)))?;
        Some(world_from_cam.direction(&ray.normalize()))
    });
    rays.collect()
}

fn visibility(
    coverage: &Coverage<'_>,
    ray: &Vector3<f64>,
    depth: f64,
    opacity: f32,
    normal: &dyn Fn() -> Option<Vector3<f64>>,
) -> Visibility {
    let mut visibility = UNSEEN;
    if opacity >= LEAST_SHARE && depth > 0.0 {
        let seen = coverage.surface(ray, depth, normal().as_ref());
        if seen.photos > 0 {
            visibility.surface = known(coverage.looked_through(ray, depth));
            visibility.photos = seen.photos as f32;
            visibility.photo_distance = seen.distance as f32;
            visibility.residual = seen.error.unwrap_or(0.0) as f32;
            if seen.incidence_deg < 180.0 {
                visibility.incidence_deg = seen.incidence_deg as f32;
            }
        }
    }
    if opacity > MIN_OPACITY {
        // What shines through a surface is as certain as the surface: photos that show it show both.
        visibility.sky = visibility.surface;
    } else {
        let seen = coverage.sky(ray);
        if seen.photos > 0 {
            visibility.sky = known(coverage.looked_through(ray, f64::INFINITY));
            // Haze before a sky that photos show is theirs too.
            visibility.surface = visibility.surface.max(visibility.sky);
        }
        visibility.photos = seen.photos as f32;
        visibility.residual = seen.error.unwrap_or(0.0) as f32;
        (visibility.photo_distance, visibility.incidence_deg) = (-1.0, -1.0);
    }
    visibility
}

/// Returns how certain the space before a point is if this share of the photos looked through it.
///
/// From a half on it is certain, since a camera's own surroundings are hardly seen by others.
fn known(looked_through: f64) -> f64 {
    (2.0 * looked_through).min(1.0)
}

/// Returns the normal of the surface at a pixel from its four neighbours, towards the eye. `None` at an edge.
fn normal(
    rays: &[Option<Vector3<f64>>],
    surfaces: &Surfaces,
    pixel: usize,
    width: usize,
) -> Option<Vector3<f64>> {
    let (column, own) = (pixel % width, surfaces.depth[pixel]);
    if column == 0 || column + 1 == width || pixel < width || pixel + width >= rays.len() {
        return None;
    }
    let point = |pixel: usize| {
        let depth = surfaces.depth[pixel];
        let same = surfaces.opacity[pixel] > MIN_OPACITY && (depth - own).abs() <= ONE_SURFACE * own;
        same.then_some(rays[pixel]? * depth)
    };
    let across = point(pixel + 1)? - point(pixel - 1)?;
    let down = point(pixel + width)? - point(pixel - width)?;
    // x right and y down in the picture, so that their product points away from the eye.
    let normal = down.cross(&across);
    (normal.norm_squared() > 0.0).then_some(normal)
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_scene::Pose;

    const SIDE: u32 = 21;

    /// A view of a floor 1 below the eye, tilted by nothing: rays downwards meet it, others the sky.
    fn view() -> (Viewpoint, Surfaces) {
        let place = Viewpoint {
            name: String::new(),
            camera: Camera::pinhole(SIDE, SIDE, 10.0),
            cam_from_world: Pose::identity(),
        };
        let rays = rays(&place);
        let down = |ray: &Option<Vector3<f64>>| ray.map_or(0.0, |ray| ray.y);
        let surfaces = Surfaces {
            depth: rays
                .iter()
                .map(|ray| if down(ray) > 0.1 { 1.0 / down(ray) } else { 0.0 })
                .collect(),
            opacity: rays
                .iter()
                .map(|ray| if down(ray) > 0.1 { 1.0 } else { 0.0 })
                .collect(),
        };
        (place, surfaces)
    }

    fn witnesses(place: &Viewpoint, surfaces: &Surfaces) -> Witnesses {
        let distance = surfaces.depth.iter().map(|depth| {
            if *depth > 0.0 {
                *depth as f32
            } else {
                f32::INFINITY
            }
        });
        let distance: Vec<f32> = distance.collect();
        Witnesses {
            observers: vec![Observer::new(place.camera, place.cam_from_world, &distance)],
            reach: 2.0,
        }
    }

    #[test]
    fn a_view_from_the_place_of_a_photo_is_seen_whole_with_the_angles_of_the_floor() {
        let (place, surfaces) = view();
        let visibilities = witnesses(&place, &surfaces).visibilities(&place, &surfaces);
        let at = |column: u32, row: u32| visibilities[(row * SIDE + column) as usize];
        let (floor, sky) = (at(10, 18), at(10, 2));
        assert_eq!((floor.surface, floor.photos), (1.0, 1.0), "{floor:?}");
        // The ray falls by 8 in 10: 38.66 degrees below the horizon, hence 51.34 from the normal of the floor.
        assert!((floor.incidence_deg - 51.34).abs() < 0.01, "{floor:?}");
        assert!((floor.photo_distance - 1.6008).abs() < 1e-3, "{floor:?}");
        assert_eq!(
            (sky.surface, sky.sky, sky.photos, sky.photo_distance),
            (1.0, 1.0, 1.0, -1.0)
        );
        assert_eq!(at(10, 20).incidence_deg, -1.0, "no neighbour below the last row");
    }

    #[test]
    fn a_sample_sees_along_the_middle_pixels_of_blocks() {
        for side in [100, 200, 320, 500, 960] {
            let photo = Camera::pinhole(side, side * 3 / 4, 300.0);
            let sample = Sample::new(&photo);
            assert!(sample.camera.width <= SIDE_PX, "{side}");
            for (column, row) in [
                (0, 0),
                (7, 3),
                (sample.camera.width - 1, sample.camera.height - 1),
            ] {
                let at = |place: u32| f64::from(place) + 0.5;
                let of_photo = |place: u32| at(place * sample.every + sample.every / 2);
                let own = sample
                    .camera
                    .unproject(&Vector2::new(at(column), at(row)))
                    .unwrap();
                let same = photo
                    .unproject(&Vector2::new(of_photo(column), of_photo(row)))
                    .unwrap();
                assert!((own - same).norm() < 1e-12, "{side}, every {}", sample.every);
            }
        }
    }

    #[test]
    fn the_error_at_photos_that_show_the_same_is_that_of_the_surface_or_of_the_sky() {
        let (place, surfaces) = view();
        let Witnesses { observers, reach } = witnesses(&place, &surfaces);
        let errors = surfaces
            .depth
            .iter()
            .map(|depth| if *depth > 0.0 { 0.25 } else { 0.5 });
        let errors: Vec<f32> = errors.collect();
        let observers = observers
            .into_iter()
            .map(|observer| observer.with_errors(errors.clone()));
        let witnesses = Witnesses {
            observers: observers.collect(),
            reach,
        };
        let visibilities = witnesses.visibilities(&place, &surfaces);
        let at = |column: u32, row: u32| visibilities[(row * SIDE + column) as usize].residual;
        assert_eq!([at(10, 18), at(10, 2)], [0.25, 0.5]);
    }

    #[test]
    fn what_no_photo_looked_at_is_unseen_floor_and_sky_alike() {
        let (place, surfaces) = view();
        let witnesses = witnesses(&place, &surfaces);
        let back = Pose::looking_at(Vector3::zeros(), -Vector3::z(), Vector3::y());
        let turned = Viewpoint {
            cam_from_world: back,
            ..place
        };
        let visibilities = witnesses.visibilities(&turned, &surfaces);
        assert!(
            visibilities.iter().all(|visibility| *visibility == UNSEEN),
            "{:?}",
            visibilities[0]
        );
    }
}
