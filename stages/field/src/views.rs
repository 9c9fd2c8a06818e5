use marf_scene::{Camera, Pose};
use nalgebra::{Vector2, Vector3};

use crate::{FieldError, Pixels};

/// A photo to learn from.
#[derive(Clone, Debug)]
pub struct View {
    /// Id of the photo, for messages.
    pub id: String,
    /// Its camera, of the image's size.
    pub camera: Camera,
    /// Its pose: x right, y down, z forward.
    pub cam_from_world: Pose,
    /// Its pixels.
    pub image: Pixels,
    /// Distances of some of its pixels, which pull the matter of their rays as sparse points do.
    pub distances: Vec<PixelDistance>,
}

/// How far away what a pixel shows is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelDistance {
    /// Column and row of the pixel.
    pub pixel: [u32; 2],
    /// Distance from the camera, units of the world. Infinite for sky, whose rays meet nothing.
    pub distance: f32,
    /// One standard deviation of it, 0 for sky.
    pub sigma: f32,
}

impl View {
    /// Returns the distance of a point of the world from the camera, if the photo shows its place.
    pub fn distance_of(&self, point: &Vector3<f64>) -> Option<f64> {
        self.pixel_of(point)?;
        Some(self.cam_from_world.point(point).norm())
    }

    /// Returns the place in the world that a distance shows. `None` for sky, and where the lens has no inverse.
    pub fn place_of(&self, shown: &PixelDistance) -> Option<[f64; 3]> {
        let [column, row] = shown.pixel.map(f64::from);
        let ray = self.camera.unproject(&Vector2::new(column + 0.5, row + 0.5))?;
        let seen = ray.normalize() * f64::from(shown.distance);
        let place = self.cam_from_world.inverse().point(&seen);
        shown.distance.is_finite().then(|| place.into())
    }

    /// Returns the pixel that shows the place of a point of the world, as column and row.
    pub fn pixel_of(&self, point: &Vector3<f64>) -> Option<[u32; 2]> {
        let pixel = self.camera.project_inside(&self.cam_from_world.point(point))?;
        Some([pixel.x as u32, pixel.y as u32])
    }
}

/// Returns the number of the first kept pixel of every view, and of all at the end.
pub fn pixel_offsets(views: &[View]) -> Vec<u64> {
    let mut offsets = vec![0];
    for view in views {
        offsets.push(offsets.last().copied().unwrap_or(0) + view.image.count() as u64);
    }
    offsets
}

/// Refuses views that nothing can be learnt from.
pub fn check_views(views: &[View]) -> Result<(), FieldError> {
    if views.is_empty() {
        return Err(FieldError::NoViews);
    }
    for view in views {
        let (camera, image) = (&view.camera, &view.image);
        if !image.is_whole() {
            return Err(FieldError::BadImage {
                id: view.id.clone(),
                width: image.width,
                height: image.height,
                pixels: image.count(),
            });
        }
        if image.is_all_hidden() {
            return Err(FieldError::AllHidden { id: view.id.clone() });
        }
        if !camera.is_valid() || !view.cam_from_world.is_valid() {
            return Err(FieldError::BadCamera { id: view.id.clone() });
        }
        if (camera.width, camera.height) != (image.width, image.height) {
            return Err(FieldError::SizeMismatch {
                id: view.id.clone(),
                camera_width: camera.width,
                camera_height: camera.height,
                width: image.width,
                height: image.height,
            });
        }
    }
    Ok(())
}

/// Refuses points that are not finite.
pub fn check_points(points: &[[f64; 3]]) -> Result<(), FieldError> {
    match points
        .iter()
        .position(|point| !point.iter().all(|value| value.is_finite()))
    {
        Some(index) => Err(FieldError::BadPoint {
            index,
            position: points[index],
        }),
        None => Ok(()),
    }
}
