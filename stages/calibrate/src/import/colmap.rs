//! COLMAP's models: cameras, images and points3D, as `.bin` or `.txt`.
//!
//! Format: <https://colmap.github.io/format.html>. World to camera, x right, y down, z forward, the first pixel
//! centre at (0.5, 0.5): as here.

mod binary;
mod record;
mod text;

use std::collections::BTreeMap;

use marf_scene::{Camera, Point, Pose, Scene};
use nalgebra::{Matrix3, Quaternion, Vector2, Vector3};

use super::cameras::{Cameras, ImportError, Role, View};
use super::distortion::Distortion;
use super::lens::Lens;
use super::paths::path;
use crate::export::{Observation, TrackPoint, Tracks};
use record::Image;

/// The files of a model.
#[derive(Debug, Clone, Copy)]
pub struct Model<'a> {
    /// Names of cameras, images and points, for messages.
    pub names: [&'a str; 3],
    /// Content of the cameras.
    pub cameras: &'a [u8],
    /// Content of the images.
    pub images: &'a [u8],
    /// Content of the points. Without it the model has none.
    pub points: Option<&'a [u8]>,
}

/// Reads cameras.bin, images.bin and points3D.bin.
///
/// All lenses up to number 10 but FOV and THIN_PRISM_FISHEYE are read. Names of images are relative to the archive's `images` folder or to
/// any folder that makes them unique. All points are kept, sorted by number. Each image's error is the mean distance of its observations
/// from their points' projections.
///
/// # Errors
/// Names file and record. Refused are a file that ends early or is longer than its records, another lens, and a number that is not finite.
/// So are a size or focal length that is not positive, a quaternion that is not a rotation, and an image without its camera. No memory is
/// reserved for a length in a file before the file is known to have it.
pub fn read_colmap_binary(model: &Model<'_>) -> Result<Cameras, ImportError> {
    Parts {
        lenses: binary::lenses(model.names[0], model.cameras)?,
        images: binary::images(model.names[1], model.images)?,
        points: model
            .points
            .map_or(Ok(BTreeMap::new()), |bytes| binary::points(model.names[2], bytes))?,
    }
    .assemble(model)
}

/// Reads cameras.txt, images.txt and points3D.txt. See [`read_colmap_binary`].
///
/// # Errors
/// As there, with the line.
pub fn read_colmap_text(model: &Model<'_>) -> Result<Cameras, ImportError> {
    Parts {
        lenses: text::lenses(model.names[0], model.cameras)?,
        images: text::images(model.names[1], model.images)?,
        points: model
            .points
            .map_or(Ok(BTreeMap::new()), |bytes| text::points(model.names[2], bytes))?,
    }
    .assemble(model)
}

/// Reads the points of a scene with their observations from the images.bin and points3D.bin that were written of it.
///
/// The error of a point is the mean distance of its observations from its projections, in pixels. `names`: those of images
/// and points, for messages.
///
/// # Errors
/// As [`read_colmap_binary`].
pub fn read_tracks(
    scene: &Scene,
    names: [&str; 2],
    images: &[u8],
    points: &[u8],
) -> Result<Tracks, ImportError> {
    let frame_of: BTreeMap<&str, usize> = (0..)
        .zip(&scene.frames)
        .map(|(index, frame)| (frame.file.as_str(), index))
        .collect();
    let track = |point: Point| TrackPoint {
        position: point.position,
        color: point.color.unwrap_or([128; 3]),
        error_px: 0.0,
        observations: Vec::new(),
    };
    let points = binary::points(names[1], points)?.into_iter();
    let mut tracks: BTreeMap<u64, TrackPoint> =
        points.map(|(number, point)| (number, track(point))).collect();
    for image in binary::images(names[0], images)? {
        let Some(frame) = frame_of.get(image.name.as_str()) else {
            continue;
        };
        for (pixel, number) in image.observations {
            if let Some(track) = tracks.get_mut(&number) {
                track.observations.push(Observation {
                    frame: *frame as u32,
                    pixel,
                    tone: None,
                });
            }
        }
    }
    let mut tracks = Tracks {
        points: tracks.into_values().collect(),
    };
    tracks.measure(scene);
    Ok(tracks)
}

/// The three files, read.
struct Parts {
    lenses: BTreeMap<u32, Lens>,
    images: Vec<Image>,
    points: BTreeMap<u64, Point>,
}

impl Parts {
    /// Returns the views of all images, and the points.
    fn assemble(self, model: &Model<'_>) -> Result<Cameras, ImportError> {
        if self.images.is_empty() {
            return Err(ImportError::new(model.names[1], "", "holds no image"));
        }
        let views: Result<Vec<View>, ImportError> =
            self.images.iter().map(|image| self.view(model, image)).collect();
        Ok(Cameras {
            views: views?,
            points: self.points.into_values().collect(),
            rejected: Vec::new(),
        })
    }

    /// Returns the view of an image.
    fn view(&self, model: &Model<'_>, image: &Image) -> Result<View, ImportError> {
        let fail = |problem: String| ImportError::new(model.names[1], &image.place, problem);
        let lens = self.lenses.get(&image.camera);
        let lens =
            lens.ok_or_else(|| fail(format!("camera {} is not in {}", image.camera, model.names[0])))?;
        let cam_from_world = pose(image).map_err(fail)?;
        let file = path("", &image.name).ok_or_else(|| fail(format!("`{}` names no file", image.name)))?;
        Ok(View {
            place: image.place.clone(),
            file,
            mask: None,
            lens: *lens,
            cam_from_world,
            role: Role::Open,
            matches: Some(image.features),
            inliers: Some(image.observations.len() as u32),
            error_px: self.error_px(image, lens, &cam_from_world),
        })
    }

    /// Mean distance of the observations from the projections of their points.
    fn error_px(&self, image: &Image, lens: &Lens, cam_from_world: &Pose) -> Option<f64> {
        let (width, height) = lens.size?;
        let camera = lens.camera(width, height).ok()?;
        let distances = image.observations.iter().filter_map(|(seen, point)| {
            let point = self.points.get(point)?;
            let pixel = project(
                lens,
                &camera,
                &cam_from_world.point(&Vector3::from(point.position)),
            )?;
            Some((pixel - Vector2::from(*seen)).norm())
        });
        let distances: Vec<f64> = distances.collect();
        let mean = distances.iter().sum::<f64>() / distances.len() as f64;
        mean.is_finite().then_some(mean)
    }
}

/// Returns the pixel of a point of the camera frame through a lens. [`Camera`] may lack its distortion.
fn project(lens: &Lens, camera: &Camera, point: &Vector3<f64>) -> Option<Vector2<f64>> {
    if let Distortion::Brown(_) = lens.distortion {
        return camera.project(point);
    }
    let ideal = Vector2::new(point.x / point.z, point.y / point.z);
    let seen = lens.distortion.distort(&ideal);
    (point.z > 0.0).then(|| {
        Vector2::new(
            camera.fx_px * seen.x + camera.cx_px,
            camera.fy_px * seen.y + camera.cy_px,
        )
    })
}

/// Returns the pose of an image, or an error if the numbers are not a pose.
fn pose(image: &Image) -> Result<Pose, String> {
    let numbers = || image.quaternion.into_iter().chain(image.translation);
    if numbers().any(|number| !number.is_finite()) {
        return Err(format!("a pose with {:?}", numbers().collect::<Vec<_>>()));
    }
    let [w, x, y, z] = image.quaternion;
    let length = Quaternion::new(w, x, y, z).norm();
    if (length - 1.0).abs() > 1e-3 {
        return Err(format!("a quaternion of length {length}, not 1"));
    }
    let [w, x, y, z] = image.quaternion.map(|number| number / length);
    Ok(Pose {
        rotation: Matrix3::new(
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y - w * z),
            2.0 * (x * z + w * y),
            2.0 * (x * y + w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z - w * x),
            2.0 * (x * z - w * y),
            2.0 * (y * z + w * x),
            1.0 - 2.0 * (x * x + y * y),
        ),
        translation: Vector3::from(image.translation),
    })
}

#[cfg(test)]
mod tests;
