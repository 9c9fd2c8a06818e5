use std::ops::Range;

use marf_scene::{Camera, Pose};

use crate::{Field, FieldError, Render};

/// Pixels of one band: a fraction of a second of work, the same on every machine.
const BAND_PX: u32 = 1 << 16;

/// Renders a photo in bands of rows, so that a large one can be stopped and continued.
///
/// `band` receives the rows of each band, from the top, and a function that renders them. It returns that
/// render, or an equal one from elsewhere. The picture is [`Field::render`]'s, to the bit.
///
/// # Errors
/// Whatever `band` returns.
pub fn render_in_bands<E>(
    field: &Field,
    camera: &Camera,
    cam_from_world: &Pose,
    mut band: impl FnMut(Range<u32>, &dyn Fn() -> Result<Render, FieldError>) -> Result<Render, E>,
) -> Result<Render, E> {
    let rows = (BAND_PX / camera.width.max(1)).max(1).next_multiple_of(8);
    let mut whole = Render::empty(camera.width, camera.height);
    for top in (0..camera.height).step_by(rows as usize) {
        let rows = top..camera.height.min(top + rows);
        let render = || field.rows(camera, cam_from_world, rows.clone());
        let band = band(rows.clone(), &render)?;
        let first = top as usize * camera.width as usize;
        let pixels = first..first + band.rgb.len();
        whole.rgb[pixels.clone()].copy_from_slice(&band.rgb);
        whole.opacity[pixels.clone()].copy_from_slice(&band.opacity);
        whole.depth[pixels].copy_from_slice(&band.depth);
    }
    Ok(whole)
}
