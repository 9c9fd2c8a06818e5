use marf_scene::{Camera, Pose};

use crate::{Field, Render};

/// Pixels of one band: a fraction of a second of work, the same on every machine.
const BAND_PX: u32 = 1 << 16;

/// Renders a photo in bands of rows and asks `keep_going` before each, so that a large one can be stopped.
///
/// The bands depend on the camera alone, hence so does the picture.
///
/// # Errors
/// Whatever `keep_going` answers.
pub fn render_in_bands<E>(
    field: &Field,
    camera: &Camera,
    cam_from_world: &Pose,
    mut keep_going: impl FnMut() -> Result<(), E>,
) -> Result<Render, E> {
    let rows = (BAND_PX / camera.width.max(1)).max(1);
    let pixels = camera.width as usize * camera.height as usize;
    let mut whole = Render {
        width: camera.width,
        height: camera.height,
        rgb: Vec::with_capacity(pixels),
        opacity: Vec::with_capacity(pixels),
        depth: Vec::with_capacity(pixels),
    };
    for top in (0..camera.height).step_by(rows as usize) {
        keep_going()?;
        let band = Camera {
            height: rows.min(camera.height - top),
            cy_px: camera.cy_px - f64::from(top),
            ..*camera
        };
        let part = field.render(&band, cam_from_world);
        whole.rgb.extend(part.rgb);
        whole.opacity.extend(part.opacity);
        whole.depth.extend(part.depth);
    }
    Ok(whole)
}
