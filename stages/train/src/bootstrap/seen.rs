use marf_cache::{Digest, digest_of};
use marf_field::Field;
use marf_scene::{Camera, Coverage, Observer, PosedPhoto, Scene, path::Viewpoint, typical_distance};
use marf_stage::StageError;
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use super::maps::{MIN_OPACITY, Sight, Surfaces};
use crate::{checkpoint::Journal, error::field_failed, photos::PhotoReader, split::NamedFrame, view::floats};

/// Longest side at which depths of the photos are rendered, pixels: what hides a point is known to one of these.
const SIDE_PX: u32 = 160;
/// Of a pixel less than this share matter, or sky, has no part in what is seen of it.
const LEAST_SHARE: f32 = 0.02;
/// Neighbouring pixels farther apart in depth than this share are no one surface.
const ONE_SURFACE: f64 = 0.2;

/// The photos that a field is trained on, with the depths of the field at their views.
pub(crate) struct Witnesses {
    observers: Vec<Observer>,
    /// Typical distance to what photos show, world units.
    reach: f64,
}

impl Witnesses {
    /// Renders the depths of the photos' views with a field; `of` stands for the node and its field.
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
            let note = format!("what {} saw", named.name);
            ctx.progress.at(index as u64, frames.len() as u64, &note);
            let (factor, camera) = small(&named.frame.camera);
            let pose = named.frame.cam_from_world;
            let pixels = camera.width as usize * camera.height as usize;
            let distance = journal.piece(
                |bytes| floats(bytes).filter(|distance| distance.len() == pixels),
                || {
                    let render = field.render(&camera, &pose).map_err(field_failed)?;
                    let of_pixel = render.depth.iter().zip(&render.opacity);
                    let distance = of_pixel.map(|(depth, opacity)| {
                        if *opacity > MIN_OPACITY {
                            *depth
                        } else {
                            f32::INFINITY
                        }
                    });
                    let distance: Vec<f32> = distance.collect();
                    let bytes = distance.iter().flat_map(|value| value.to_le_bytes()).collect();
                    Ok((distance, bytes))
                },
            )?;
            let hidden = photos.hidden_at(named.frame, factor)?;
            let mut distance = distance;
            for (distance, _) in distance.iter_mut().zip(hidden).filter(|(_, hidden)| *hidden) {
                *distance = f32::NAN;
            }
            Ok(Observer::new(camera, pose, &distance))
        });
        let observers = observers.collect::<Result<_, StageError>>()?;
        journal.end();
        let photos: Vec<PosedPhoto<'_>> = frames.iter().map(|named| named.frame.into()).collect();
        Ok(Self {
            observers,
            reach: typical_distance(&photos, &scene.points),
        })
    }

    /// Returns what the photos saw of each pixel of a view with these mean depths and opacities.
    pub fn sights(&self, place: &Viewpoint, surfaces: &Surfaces) -> Vec<Sight> {
        let coverage = Coverage::from_viewpoint(&self.observers, &place.cam_from_world, self.reach);
        let rays = rays(place);
        let width = place.camera.width as usize;
        let sight = |pixel: usize| {
            let Some(ray) = rays[pixel] else { return UNSEEN };
            let normal = || normal(&rays, surfaces, pixel, width);
            sight(
                &coverage,
                &ray,
                surfaces.depth[pixel],
                surfaces.opacity[pixel],
                &normal,
            )
        };
        (0..rays.len()).into_par_iter().map(sight).collect()
    }
}

/// No photo saw any of it.
const UNSEEN: Sight = Sight {
    surface: 0.0,
    sky: 0.0,
    photos: 0.0,
    photo_distance: -1.0,
    incidence_deg: -1.0,
};

/// Returns the factor by which a photo is shrunk for its depths, and its camera then.
fn small(camera: &Camera) -> (u32, Camera) {
    let longest = camera.width.max(camera.height);
    let shortest = camera.width.min(camera.height).max(1);
    let factor = longest.div_ceil(SIDE_PX).clamp(1, shortest);
    (factor, camera.box_reduced(factor))
}

/// Returns the unit vector of the world along every pixel of a view; none where the lens has no ray for it.
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

fn sight(
    coverage: &Coverage<'_>,
    ray: &Vector3<f64>,
    depth: f64,
    opacity: f32,
    normal: &dyn Fn() -> Option<Vector3<f64>>,
) -> Sight {
    let mut sight = UNSEEN;
    if opacity >= LEAST_SHARE && depth > 0.0 {
        let seen = coverage.surface(ray, depth, normal().as_ref());
        if seen.photos > 0 {
            sight.surface = known(coverage.looked_through(ray, depth));
            sight.photos = seen.photos as f32;
            sight.photo_distance = seen.distance as f32;
            if seen.incidence_deg < 180.0 {
                sight.incidence_deg = seen.incidence_deg as f32;
            }
        }
    }
    if opacity > MIN_OPACITY {
        // What shines through a surface is as certain as the surface: photos that show it show both.
        sight.sky = sight.surface;
    } else {
        let photos = coverage.sky(ray);
        if photos > 0 {
            sight.sky = known(coverage.looked_through(ray, f64::INFINITY));
            // Haze before a sky that photos show is theirs too.
            sight.surface = sight.surface.max(sight.sky);
        }
        sight.photos = photos as f32;
        (sight.photo_distance, sight.incidence_deg) = (-1.0, -1.0);
    }
    sight
}

/// Returns how certain the space before a point is of which photos looked through a share: wholly from a half on, since a camera stands in
/// space that others hardly see.
fn known(looked_through: f64) -> f64 {
    (2.0 * looked_through).min(1.0)
}

/// Returns the normal of the surface at a pixel from its four neighbours, towards the eye; none at an edge.
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
        let sights = witnesses(&place, &surfaces).sights(&place, &surfaces);
        let at = |column: u32, row: u32| sights[(row * SIDE + column) as usize];
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
    fn what_no_photo_looked_at_is_unseen_floor_and_sky_alike() {
        let (place, surfaces) = view();
        let witnesses = witnesses(&place, &surfaces);
        let back = Pose::looking_at(Vector3::zeros(), -Vector3::z(), Vector3::y());
        let turned = Viewpoint {
            cam_from_world: back,
            ..place
        };
        let sights = witnesses.sights(&turned, &surfaces);
        assert!(sights.iter().all(|sight| *sight == UNSEEN), "{:?}", sights[0]);
    }
}
