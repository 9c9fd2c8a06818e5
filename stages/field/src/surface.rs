//! Where a field has found matter, as points.

use nalgebra::Vector2;

use crate::{Field, FieldError, View};

/// Pixels a photo's longer side has at most while it is looked at.
const SIDE_PX: u32 = 32;
/// Photos that are looked at, at most.
const VIEWS: usize = 64;
/// A pixel shows a surface where at least this share of its ray met matter.
const OPAQUE: f32 = 0.5;

/// Returns a point of the world for every pixel of small renders of the views that shows a surface.
///
/// # Errors
/// A GPU that failed.
pub fn surface_points(field: &Field, views: &[View]) -> Result<Vec<[f64; 3]>, FieldError> {
    let mut points = Vec::new();
    for view in views.iter().step_by(views.len().div_ceil(VIEWS)) {
        let longest = view.camera.width.max(view.camera.height);
        let shortest = view.camera.width.min(view.camera.height);
        let camera = view
            .camera
            .box_reduced(longest.div_ceil(SIDE_PX).clamp(1, shortest));
        let render = field.render(&camera, &view.cam_from_world)?;
        let world_from_cam = view.cam_from_world.inverse();
        for (pixel, (depth, opacity)) in render.depth.iter().zip(&render.opacity).enumerate() {
            let (column, row) = (pixel as u32 % render.width, pixel as u32 / render.width);
            let centre = Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            let Some(ray) = camera.unproject(&centre).filter(|_| *opacity >= OPAQUE) else {
                continue;
            };
            let point = world_from_cam.point(&(ray.normalize() * f64::from(*depth)));
            points.push(point.into());
        }
    }
    Ok(points)
}
