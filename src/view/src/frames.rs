//! Pictures of a field for the 3-D view: coarse first, then finer, until a newer pose is requested.

use std::sync::Arc;

use marf_field::{Field as Trained, FieldError, Render};
use marf_scene::picture::ColorScale;
use marf_scene::{Camera, Image, Pose, Srgb, encode_png};
use serde::Deserialize;

use crate::difference::Reference;
use crate::field::{Field, depths, spread};

/// A picture is rendered at these fractions of its size, one after the other.
pub const DIVISORS: [u32; 4] = [8, 4, 2, 1];
/// Most pixels of a picture.
const MOST_PX: u64 = 4 << 20;
/// Pixels between two checks whether a picture is still wanted: some hundredths of a second of work.
const BAND_PX: u32 = 1 << 14;
/// Rows of a band are a multiple of this, the height of what the renderer traces at once: its pixels are then those of the
/// whole picture.
const BAND_ROWS: u32 = 32;

/// Content of a picture.
#[derive(Debug, Clone)]
pub enum Shown {
    /// Colour.
    Color,
    /// Distance along the ray.
    Depth,
    /// How far the retrainings differ in gray.
    Uncertainty,
    /// How far the colour is from a photo, from the photo's pose.
    Difference(Arc<Reference>),
}

/// A requested view.
#[derive(Debug, Clone, Deserialize)]
pub struct View {
    /// Its camera.
    pub camera: Camera,
    /// Its pose.
    pub cam_from_world: Pose,
}

impl View {
    /// Checks what came from outside.
    ///
    /// # Errors
    /// One sentence.
    pub fn check(&self) -> Result<(), String> {
        let pixels = u64::from(self.camera.width) * u64::from(self.camera.height);
        if !self.camera.is_valid() || !self.cam_from_world.is_valid() {
            return Err("the camera or its pose is not finite, not positive or not a rotation".to_owned());
        }
        if pixels > MOST_PX {
            return Err(format!("{pixels} pixels are too many: at most {MOST_PX}"));
        }
        Ok(())
    }
}

/// Reason for a missing picture.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// A newer view is wanted.
    #[error("a newer view is wanted")]
    Stopped,
    /// It cannot be rendered.
    #[error("{0}")]
    Failed(String),
}

impl From<FieldError> for FrameError {
    fn from(error: FieldError) -> Self {
        Self::Failed(error.to_string())
    }
}

/// Renders a view at a fraction of its size and returns it as it is sent: width, height, divisor and length of the PNG as u32
/// LE, then the PNG.
///
/// # Errors
/// See [`FrameError`].
pub fn frame(
    field: &Field,
    view: &View,
    shown: &Shown,
    divisor: u32,
    stopped: &dyn Fn() -> bool,
) -> Result<Vec<u8>, FrameError> {
    let (width, height) = (
        view.camera.width.div_ceil(divisor),
        view.camera.height.div_ceil(divisor),
    );
    let camera = view.camera.resized(width, height);
    let render = |trained: &Trained| in_bands(trained, &camera, &view.cam_from_world, stopped);
    let image = match shown {
        Shown::Color => render(field.trained())?.to_image(),
        Shown::Depth => {
            let values = depths(&render(field.trained())?);
            colored(&values, &field.scales().depth, width, height)
        }
        Shown::Uncertainty => {
            let renders: Vec<Render> = field.members().iter().map(render).collect::<Result<_, _>>()?;
            let values = spread(&renders);
            if values.is_empty() {
                return Err(FrameError::Failed(
                    "the run has no retrainings, hence no uncertainty".to_owned(),
                ));
            }
            colored(&values, &field.scales().uncertainty, width, height)
        }
        Shown::Difference(reference) => {
            let values = reference.differences(&render(field.trained())?.to_image());
            colored(&values, &field.scales().difference, width, height)
        }
    };
    let png = encode_png(&image).map_err(|error| FrameError::Failed(error.to_string()))?;
    let numbers = [width, height, divisor, png.len() as u32];
    let head = numbers.iter().flat_map(|number| number.to_le_bytes());
    Ok(head.chain(png.iter().copied()).collect())
}

/// Draws values on a scale.
fn colored(values: &[f32], scale: &ColorScale, width: u32, height: u32) -> Image<Srgb> {
    Image {
        width,
        height,
        pixels: values.iter().map(|value| scale.color(*value)).collect(),
    }
}

/// Renders a picture band by band, as long as it is wanted.
fn in_bands(
    field: &Trained,
    camera: &Camera,
    cam_from_world: &Pose,
    stopped: &dyn Fn() -> bool,
) -> Result<Render, FrameError> {
    let mut whole = Render::empty(camera.width, 0);
    let rows = (BAND_PX / camera.width.max(1)).max(1).next_multiple_of(BAND_ROWS);
    for top in (0..camera.height).step_by(rows as usize) {
        if stopped() {
            return Err(FrameError::Stopped);
        }
        let band = field.render(
            &window(
                camera,
                [0, i64::from(top)],
                [camera.width, rows.min(camera.height - top)],
            ),
            cam_from_world,
        )?;
        whole.rgb.extend_from_slice(&band.rgb);
        whole.opacity.extend_from_slice(&band.opacity);
        whole.depth.extend_from_slice(&band.depth);
    }
    whole.height = camera.height;
    Ok(whole)
}

/// Returns the camera of a part of a picture: its left and top edge, which may be outside, its width and height, pixels.
pub fn window(camera: &Camera, [left, top]: [i64; 2], [width, height]: [u32; 2]) -> Camera {
    Camera {
        width,
        height,
        cx_px: camera.cx_px - left as f64,
        cy_px: camera.cy_px - top as f64,
        ..*camera
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_rendered_is_refused_with_the_number() {
        let view = |camera| View {
            camera,
            cam_from_world: Pose::identity(),
        };
        assert!(view(Camera::pinhole(640, 480, 500.0)).check().is_ok());
        let large = view(Camera::pinhole(4096, 4096, 500.0)).check().unwrap_err();
        assert!(large.contains("16777216"), "{large}");
        for camera in [
            Camera::pinhole(0, 480, 500.0),
            Camera::pinhole(640, 480, f64::NAN),
        ] {
            assert!(view(camera).check().is_err());
        }
    }

    #[test]
    fn a_pixel_of_a_window_looks_where_that_of_the_picture_looks() {
        let camera = Camera {
            k1: 0.05,
            ..Camera::pinhole(400, 300, 320.0)
        };
        let part = window(&camera, [37, 64], [1, 1]);
        let ray = |camera: &Camera, x, y| camera.unproject(&nalgebra::Vector2::new(x, y)).unwrap();
        assert!((ray(&part, 0.5, 0.5) - ray(&camera, 37.5, 64.5)).norm() < 1e-12);
    }
}
