use marf_scene::{Camera, Pose};

use crate::{Field, FieldError, Render};

/// Pixels of one band: a fraction of a second of work, the same on every machine.
const BAND_PX: u32 = 1 << 16;

/// Renders a photo in bands of rows, so that a large one can be stopped. The picture is [`Field::render`]'s, to the bit.
///
/// # Errors
/// What `check` returns, which is called before each band. The inner result has the errors of the field.
pub fn render_in_bands<E>(
    field: &Field,
    camera: &Camera,
    cam_from_world: &Pose,
    mut check: impl FnMut() -> Result<(), E>,
) -> Result<Result<Render, FieldError>, E> {
    let rows = (BAND_PX / camera.width.max(1)).max(1).next_multiple_of(8);
    let mut whole = Render::empty(camera.width, camera.height);
    for top in (0..camera.height).step_by(rows as usize) {
        check()?;
        let band = match field.rows(camera, cam_from_world, top..camera.height.min(top + rows)) {
            Ok(band) => band,
            Err(error) => return Ok(Err(error)),
        };
        let first = top as usize * camera.width as usize;
        let pixels = first..first + band.rgb.len();
        whole.rgb[pixels.clone()].copy_from_slice(&band.rgb);
        whole.opacity[pixels.clone()].copy_from_slice(&band.opacity);
        whole.depth[pixels].copy_from_slice(&band.depth);
    }
    Ok(Ok(whole))
}
