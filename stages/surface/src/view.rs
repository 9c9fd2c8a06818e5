//! The view of a field at a photo, as planes in space: one a pixel.

use marf_scene::{Camera, Pose};
use nalgebra::{Matrix3, Vector2, Vector3};
use rayon::prelude::*;

/// Pixels to each side of a pixel that its plane is fitted to.
const REACH: i64 = 2;
/// Rules for a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaneRules {
    /// Pixels of the window that must lie on one surface with its middle, of 25.
    pub least_pixels: usize,
    /// A neighbour whose inverse depth differs by more than this share is on another surface.
    pub one_surface: f64,
    /// Root mean square of the residuals of the fit, as a share of the inverse depth, above which there is no
    /// plane: an edge, or fog.
    pub roughest: f64,
    /// Least cosine of the angle between ray and normal.
    pub least_cosine: f64,
}

impl PlaneRules {
    /// The measurable ones: planes of half a window that scatter by 1 %, seen no flatter than 84 degrees.
    /// Flatter views give no usable depth.
    pub const MEASURED: Self = Self {
        least_pixels: 13,
        one_surface: 0.06,
        roughest: 0.01,
        least_cosine: 0.105,
    };
    /// Rules for looking only: far ground, which is seen flat, and rough edges too.
    pub const SHOWN: Self = Self {
        least_pixels: 6,
        one_surface: 0.2,
        roughest: 0.1,
        least_cosine: 0.01,
    };
}

/// The surface that a pixel shows: a plane through a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    /// Distance from the camera along the ray, world units.
    pub distance: f32,
    /// Unit normal in the world, towards the camera.
    pub normal: [f32; 3],
    /// Cosine of the angle between normal and the direction to the camera, in (0, 1].
    pub cosine: f32,
}

/// The surfaces that a field shows at the view of a photo.
#[derive(Debug, Clone)]
pub struct SurfaceView {
    camera: Camera,
    cam_from_world: Pose,
    centre: Vector3<f64>,
    /// `[height * width]`. `None` if the pixel shows no reliable surface.
    patches: Vec<Option<Patch>>,
    /// `[height * width]`, sRGB in [0, 1].
    colors: Vec<[f32; 3]>,
}

impl SurfaceView {
    /// Fits a plane to the surroundings of every pixel.
    ///
    /// A plane n · x = d in the camera's frame has the inverse depth 1/z = (n / d) · (X, Y, 1) at the ray (X,
    /// Y, 1), which is linear in the ray: least squares over 5 x 5 pixels give normal and depth at once.
    /// Pixels whose inverse depth differs by more than 6 % from the middle are left out. There is no plane if
    /// fewer than 13 remain, if they scatter by more than 1 %, or if the surface is seen flatter than 84
    /// degrees from its normal ([`PlaneRules::MEASURED`]).
    ///
    /// - `distance`: `[height * width]`, along the ray of each pixel, world units. Infinite where the ray
    ///   meets nothing, NaN where a mask hides the pixel.
    /// - `colors`: `[height * width]`, sRGB in [0, 1].
    ///
    /// # Panics
    /// If there is not a distance and a colour for every pixel: a slip of the program.
    pub fn new(camera: Camera, cam_from_world: Pose, distance: &[f32], colors: Vec<[f32; 3]>) -> Self {
        Self::with_rules(camera, cam_from_world, distance, colors, &PlaneRules::MEASURED)
    }

    /// Like [`new`](Self::new), with other rules.
    ///
    /// # Panics
    /// As there.
    pub fn with_rules(
        camera: Camera,
        cam_from_world: Pose,
        distance: &[f32],
        colors: Vec<[f32; 3]>,
        rules: &PlaneRules,
    ) -> Self {
        let pixels = camera.width as usize * camera.height as usize;
        assert_eq!(
            (distance.len(), colors.len()),
            (pixels, pixels),
            "a value for every pixel"
        );
        let inverse: Vec<Option<Sample>> = (0..pixels)
            .into_par_iter()
            .map(|pixel| Sample::new(&camera, pixel, distance[pixel]))
            .collect();
        let world_from_cam = cam_from_world.inverse();
        let patches = (0..pixels).into_par_iter().map(|pixel| {
            let fitted = fit(&camera, &inverse, pixel, rules)?;
            let normal = world_from_cam.direction(&fitted.normal);
            Some(Patch {
                distance: fitted.distance as f32,
                normal: [normal.x as f32, normal.y as f32, normal.z as f32],
                cosine: fitted.cosine as f32,
            })
        });
        Self {
            patches: patches.collect(),
            centre: cam_from_world.centre(),
            camera,
            cam_from_world,
            colors,
        }
    }

    /// Returns the camera's place, world units.
    pub fn centre(&self) -> Vector3<f64> {
        self.centre
    }

    /// Puts the camera elsewhere, turned as it is.
    #[cfg(test)]
    pub fn move_to(&mut self, centre: Vector3<f64>) {
        self.cam_from_world.translation = -(self.cam_from_world.rotation * centre);
        self.centre = centre;
    }

    /// Returns the width of a pixel at a distance of one.
    pub fn pixel_angle(&self) -> f64 {
        1.0 / self.camera.fx_px.min(self.camera.fy_px)
    }

    /// Returns the camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Returns the camera's pose.
    pub fn cam_from_world(&self) -> &Pose {
        &self.cam_from_world
    }

    /// Returns the colours of all pixels, `[height * width]`, sRGB in [0, 1].
    pub fn colors(&self) -> &[[f32; 3]] {
        &self.colors
    }

    /// Returns every pixel that shows a surface: the point, its patch and its colour.
    pub fn points(&self) -> impl Iterator<Item = (Vector3<f64>, Patch, [f32; 3])> + '_ {
        self.pixels()
            .map(|(pixel, point, patch)| (point, patch, self.colors[pixel]))
    }

    /// Returns every pixel that shows a surface, the point and its patch.
    pub fn pixels(&self) -> impl Iterator<Item = (usize, Vector3<f64>, Patch)> + '_ {
        let width = self.camera.width as usize;
        let world_from_cam = self.cam_from_world.inverse();
        self.patches.iter().enumerate().filter_map(move |(pixel, patch)| {
            let patch = (*patch)?;
            let ray = self.camera.unproject(&centre_of(pixel, width))?.normalize();
            let point = world_from_cam.point(&(ray * f64::from(patch.distance)));
            Some((pixel, point, patch))
        })
    }

    /// Returns the patch and the colour at the pixel that shows a point of the world, with the signed
    /// distance from the patch's plane to the point (world units, positive towards the camera). `None`
    /// outside of the picture and where it shows no surface.
    pub fn at(&self, point: &Vector3<f64>) -> Option<(f64, Patch, [f32; 3])> {
        let in_camera = self.cam_from_world.point(point);
        let at = self.camera.project(&in_camera)?;
        let (column, row) = (at.x.floor(), at.y.floor());
        let inside = column >= 0.0
            && row >= 0.0
            && column < f64::from(self.camera.width)
            && row < f64::from(self.camera.height);
        if !inside {
            return None;
        }
        let pixel = row as usize * self.camera.width as usize + column as usize;
        let patch = self.patches[pixel]?;
        let normal = Vector3::from(patch.normal.map(f64::from));
        // The patch's point is c + distance ray with normal · ray = -cosine.
        let signed = normal.dot(&(point - self.centre)) + f64::from(patch.distance) * f64::from(patch.cosine);
        Some((signed, patch, self.colors[pixel]))
    }

    /// Returns true if a ball (world units) may be in the picture.
    pub fn may_show(&self, middle: &Vector3<f64>, radius: f64) -> bool {
        let in_camera = self.cam_from_world.point(middle);
        if in_camera.z <= radius {
            // Around the camera or behind it: a ball that reaches in front of it is checked point by point.
            return in_camera.z > -radius;
        }
        let margin = radius / (in_camera.z - radius);
        let (width, height) = (f64::from(self.camera.width), f64::from(self.camera.height));
        // Lenses bend rays at the edge. Half a picture more is checked point by point.
        let spare = if self.camera.k1 == 0.0 && self.camera.k2 == 0.0 {
            0.0
        } else {
            0.5
        };
        let within = |place: f64, focal_px: f64, centre_px: f64, side: f64| {
            let at = place / in_camera.z * focal_px + centre_px;
            let more = margin * focal_px * 2.0 + spare * side;
            at > -more && at < side + more
        };
        within(in_camera.x, self.camera.fx_px, self.camera.cx_px, width)
            && within(in_camera.y, self.camera.fy_px, self.camera.cy_px, height)
    }
}

/// The centre of a pixel.
fn centre_of(pixel: usize, width: usize) -> Vector2<f64> {
    Vector2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5)
}

/// A pixel's ray (X, Y, 1) with the inverse of its depth along the optical axis.
#[derive(Debug, Clone, Copy)]
struct Sample {
    ray: Vector3<f64>,
    inverse: f64,
}

impl Sample {
    fn new(camera: &Camera, pixel: usize, distance: f32) -> Option<Self> {
        if !distance.is_finite() || distance <= 0.0 {
            return None;
        }
        let ray = camera.unproject(&centre_of(pixel, camera.width as usize))?;
        let inverse = ray.norm() / f64::from(distance);
        Some(Self { ray, inverse })
    }
}

/// A plane in the frame of the camera.
struct Plane {
    distance: f64,
    normal: Vector3<f64>,
    cosine: f64,
}

fn fit(camera: &Camera, samples: &[Option<Sample>], pixel: usize, rules: &PlaneRules) -> Option<Plane> {
    let own = samples[pixel]?;
    let (width, height) = (i64::from(camera.width), i64::from(camera.height));
    let (column, row) = (pixel as i64 % width, pixel as i64 / width);
    let (mut system, mut right, mut squares, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0.0, 0);
    for y in (row - REACH).max(0)..=(row + REACH).min(height - 1) {
        for x in (column - REACH).max(0)..=(column + REACH).min(width - 1) {
            let Some(sample) = samples[(y * width + x) as usize] else {
                continue;
            };
            // Relative to the middle, in pixels: a well-conditioned system of numbers near one.
            let value = sample.inverse / own.inverse - 1.0;
            if value.abs() > rules.one_surface {
                continue;
            }
            let at = Vector3::new(
                (sample.ray.x - own.ray.x) * camera.fx_px,
                (sample.ray.y - own.ray.y) * camera.fy_px,
                1.0,
            );
            system += at * at.transpose();
            right += at * value;
            squares += value * value;
            count += 1;
        }
    }
    if count < rules.least_pixels {
        return None;
    }
    let slope = system.cholesky()?.solve(&right);
    let residual = (squares - slope.dot(&right)).max(0.0) / count as f64;
    if residual.sqrt() > rules.roughest {
        return None;
    }
    let inverse = own.inverse * (1.0 + slope.z);
    // 1/z = a X + b Y + c with the ray (X, Y, 1): the normal is (a, b, c), away from the camera.
    let a = slope.x * own.inverse * camera.fx_px;
    let b = slope.y * own.inverse * camera.fy_px;
    let normal = -Vector3::new(a, b, inverse - a * own.ray.x - b * own.ray.y).try_normalize(1e-300)?;
    let cosine = -normal.dot(&own.ray.normalize());
    let distance = own.ray.norm() / inverse;
    (cosine >= rules.least_cosine && inverse > 0.0 && distance.is_finite()).then_some(Plane {
        distance,
        normal,
        cosine,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera at the origin that looks along +z.
    fn camera() -> Camera {
        Camera::pinhole(40, 30, 50.0)
    }

    /// Distances to the plane n · x = d.
    fn distances(camera: &Camera, normal: Vector3<f64>, d: f64) -> Vec<f32> {
        let pixels = camera.width as usize * camera.height as usize;
        let distance = (0..pixels).map(|pixel| {
            let ray = camera
                .unproject(&centre_of(pixel, camera.width as usize))
                .unwrap()
                .normalize();
            (d / normal.dot(&ray)) as f32
        });
        distance.collect()
    }

    fn view(camera: Camera, distance: &[f32]) -> SurfaceView {
        let colors = vec![[0.5; 3]; distance.len()];
        SurfaceView::new(camera, Pose::identity(), distance, colors)
    }

    #[test]
    fn the_plane_that_was_drawn_comes_back_with_its_normal_towards_the_camera() {
        let normal = Vector3::new(0.2, -0.3, 1.0).normalize();
        let view = view(camera(), &distances(&camera(), normal, 4.0));
        let mut count = 0;
        for (point, patch, _) in view.points() {
            assert!((normal.dot(&point) - 4.0).abs() < 1e-5, "{point}");
            let away = Vector3::from(patch.normal.map(f64::from)) + normal;
            assert!(away.norm() < 1e-4, "{patch:?}");
            count += 1;
        }
        // All but the corners, whose windows have 9 and 12 pixels of 25.
        assert!(count > 40 * 30 - 20, "{count}");
        let (signed, ..) = view.at(&Vector3::new(0.0, 0.0, 3.0)).unwrap();
        assert!(
            (signed - (4.0 - 3.0 * normal.z)).abs() < 1e-5,
            "{signed}: before the plane is positive"
        );
    }

    #[test]
    fn nothing_hidden_and_flat_pixels_show_no_surface() {
        let camera = camera();
        let pixels = (camera.width * camera.height) as usize;
        for bad in [f32::INFINITY, f32::NAN, 0.0, -1.0] {
            assert_eq!(view(camera, &vec![bad; pixels]).points().count(), 0, "{bad}");
        }
        // Seen at 85 degrees from the normal at the middle.
        let angle = 85_f64.to_radians();
        let flat = distances(&camera, Vector3::new(0.0, angle.sin(), angle.cos()), 4.0);
        let patch = view(camera, &flat).at(&Vector3::z());
        assert!(patch.is_none(), "{patch:?}");
    }

    #[test]
    fn an_edge_between_two_walls_bends_neither_of_them() {
        let camera = camera();
        let mut distance = distances(&camera, Vector3::z(), 4.0);
        let near = distances(&camera, Vector3::z(), 3.0);
        for pixel in (0..distance.len()).filter(|pixel| pixel % 40 < 20) {
            distance[pixel] = near[pixel];
        }
        for (point, ..) in view(camera, &distance).points() {
            let z = if point.x < 0.0 { 3.0 } else { 4.0 };
            assert!((point.z - z).abs() < 1e-5, "{point}");
        }
    }

    #[test]
    fn a_ball_aside_of_the_picture_is_not_shown_and_one_that_touches_it_may_be() {
        let view = view(camera(), &distances(&camera(), Vector3::z(), 4.0));
        assert!(view.may_show(&Vector3::new(0.0, 0.0, 4.0), 0.1));
        assert!(!view.may_show(&Vector3::new(9.0, 0.0, 4.0), 0.1));
        assert!(!view.may_show(&Vector3::new(0.0, 0.0, -4.0), 0.1));
        assert!(view.may_show(&Vector3::new(2.0, 0.0, 4.0), 0.5));
    }
}
