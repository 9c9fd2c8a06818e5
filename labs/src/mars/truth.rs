//! The true photos of the built-in Mars with the distance that each pixel shows, and where they are in a scene's world.

use std::{fs, path::Path};

use marf_demo::{Demo, DemoOptions, RangeMap, TruePhoto};
use marf_scene::{Pinhole, Pose, Scene};
use nalgebra::{Matrix3, Vector2, Vector3};

use crate::output::Result;

/// Pixels are found by a point this far along their ray, metres.
const ON_THE_WAY_M: f64 = 10.0;

/// A true photo with its ranges.
pub struct Known {
    pub photo: TruePhoto,
    pub ranges: RangeMap,
}

/// Distances from the centre of a camera, metres.
pub struct Distances {
    /// Of a place.
    pub place_m: f64,
    /// Distance of the point that the photo shows in its direction. Infinite for the sky.
    pub shown_m: f64,
}

impl Known {
    /// Returns the distances of a place (metres in the site) and of the point that the photo shows there, or `None`
    /// outside the photo.
    pub fn distances(&self, place: &Vector3<f64>) -> Option<Distances> {
        // In labels whole numbers are centres of pixels.
        let pixel = self.photo.site_model.project(place)?;
        let (column, row, map) = (pixel.x.round(), pixel.y.round(), &self.ranges);
        let inside =
            column >= 0.0 && row >= 0.0 && column < f64::from(map.width) && row < f64::from(map.height);
        inside.then(|| Distances {
            place_m: (place - self.photo.cam_from_site.centre()).norm(),
            shown_m: self.range_m(column as u32, row as u32),
        })
    }

    /// Returns the point that a pixel shows, metres in the site, or `None` for the sky and for points farther than
    /// `reach_m`.
    pub fn point(&self, column: u32, row: u32, reach_m: f64) -> Option<Vector3<f64>> {
        let range_m = self.range_m(column, row);
        let pixel = Vector2::new(f64::from(column), f64::from(row));
        let ray = self.photo.site_model.unproject(&pixel)?;
        (range_m <= reach_m && range_m.is_finite()).then(|| ray.origin + ray.direction * range_m)
    }

    /// Returns the pinhole for which `calibrate` resamples this photo, with its pose in the site, for a picture reduced to this width.
    pub fn pinhole_of_width(&self, width: u32) -> Result<Pinhole> {
        let (model, size) = (&self.photo.site_model, [self.ranges.width, self.ranges.height]);
        let exact = model.exact_pinhole(size[0], size[1])?;
        let mut pinhole = exact.map_or_else(|| model.linearised(size[0], size[1]), Ok)?;
        pinhole.camera = pinhole.camera.box_reduced(pinhole.camera.width / width);
        if pinhole.camera.width == width {
            Ok(pinhole)
        } else {
            Err(format!("{}: not the pixels of its label's pinhole", self.photo.file).into())
        }
    }

    /// As [`Known::point`], of a pixel of the photo that a [pinhole](Self::pinhole_of_width) took.
    pub fn point_of_pinhole(
        &self,
        pinhole: &Pinhole,
        pixel: &Vector2<f64>,
        reach_m: f64,
    ) -> Option<Vector3<f64>> {
        let site_from_cam = pinhole.cam_from_frame.inverse();
        let ray = pinhole.camera.unproject(pixel)?.normalize();
        let pixel = self
            .photo
            .site_model
            .project(&site_from_cam.point(&(ray * ON_THE_WAY_M)))?;
        let (column, row) = (pixel.x.round(), pixel.y.round());
        let (width, height) = (f64::from(self.ranges.width), f64::from(self.ranges.height));
        let inside = column >= 0.0 && row >= 0.0 && column < width && row < height;
        inside.then(|| self.point(column as u32, row as u32, reach_m))?
    }

    fn range_m(&self, column: u32, row: u32) -> f64 {
        f64::from(self.ranges.range_m[row as usize * self.ranges.width as usize + column as usize])
    }
}

/// A scene of a run of the built-in Mars, and its truth.
pub struct KnownScene {
    pub demo: Demo,
    pub scene: Scene,
    /// The true photos of the frames of the scene, in their order.
    pub photos: Vec<Known>,
}

impl KnownScene {
    /// Reads a scene.json.
    pub fn read(path: &Path) -> Result<Self> {
        let scene = Scene::decode(&fs::read(path)?)?;
        let demo = Demo::new(DemoOptions::default())?;
        let mut photos = Vec::new();
        for frame in &scene.frames {
            let file = frame.file.rsplit('/').next().unwrap_or_default();
            let sol = sol_of(file).ok_or("no sol in the name")?;
            let truth = demo.ground_truth(sol)?.photos;
            let stem = file.rsplit_once('.').map_or(file, |(stem, _)| stem);
            let photo = truth.into_iter().find(|photo| photo.file.starts_with(stem));
            let photo = photo.ok_or_else(|| format!("{file} is not a photo of the demo"))?;
            let ranges = demo.ranges(sol, &photo.file)?;
            photos.push(Known { photo, ranges });
        }
        Ok(Self { demo, scene, photos })
    }

    /// Returns the similarity that carries the camera centres of the scene to the true ones (Umeyama, Least-squares estimation of
    /// transformation parameters between two point patterns, PAMI 1991).
    pub fn alignment(&self) -> Similarity {
        let ours = self
            .scene
            .frames
            .iter()
            .map(|frame| frame.cam_from_world.centre());
        let ours: Vec<Vector3<f64>> = ours.collect();
        let truth = self.photos.iter().map(|known| known.photo.cam_from_site.centre());
        let truth: Vec<Vector3<f64>> = truth.collect();
        let mean = |all: &[Vector3<f64>]| all.iter().sum::<Vector3<f64>>() / all.len() as f64;
        let (from, to) = (mean(&ours), mean(&truth));
        let pairs = ours.iter().zip(&truth);
        let covariance: Matrix3<f64> = pairs.map(|(a, b)| (b - to) * (a - from).transpose()).sum();
        let spread: f64 = ours.iter().map(|a| (a - from).norm_squared()).sum();
        let svd = covariance.svd(true, true);
        let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
            return Similarity::identity();
        };
        let sign = (u.determinant() * v_t.determinant()).signum();
        let signs = Vector3::new(1.0, 1.0, sign);
        let rotation = u * Matrix3::from_diagonal(&signs) * v_t;
        let scaled = rotation * (svd.singular_values.dot(&signs) / spread);
        Similarity {
            scaled,
            shift: to - scaled * from,
        }
    }
}

/// Returns the sol of a product id such as `ZL0_0003_..`.
pub fn sol_of(name: &str) -> Option<u32> {
    name.get(4..8)?.parse().ok()
}

/// A similarity from the world of a scene to the site.
pub struct Similarity {
    /// Rotation with scale.
    pub scaled: Matrix3<f64>,
    pub shift: Vector3<f64>,
}

impl Similarity {
    pub fn identity() -> Self {
        Self {
            scaled: Matrix3::identity(),
            shift: Vector3::zeros(),
        }
    }

    /// Returns a place of the world in the site.
    pub fn point(&self, place: &Vector3<f64>) -> Vector3<f64> {
        self.scaled * place + self.shift
    }

    /// Metres per unit of the world.
    pub fn scale(&self) -> f64 {
        self.scaled.determinant().cbrt()
    }

    /// Returns the pose in the site of a camera of the world.
    pub fn pose(&self, cam_from_world: &Pose) -> Pose {
        let rotation = cam_from_world.rotation * (self.scaled / self.scale()).transpose();
        Pose {
            rotation,
            translation: -(rotation * self.point(&cam_from_world.centre())),
        }
    }
}
