use marf_scene::{Camera, Pose};

use crate::{Field, FieldError, Render};

/// Pixels of one band: a fraction of a second of work, the same on every machine.
const BAND_PX: u32 = 1 << 16;

/// Renders a photo in bands of rows and asks `keep_going` before each, so that a large one can be stopped.
///
/// The picture is [`Field::render`]'s, to the bit.
///
/// # Errors
/// Whatever `keep_going` answers, and what `failed` makes of a GPU that fails.
pub fn render_in_bands<E>(
    field: &Field,
    camera: &Camera,
    cam_from_world: &Pose,
    mut keep_going: impl FnMut() -> Result<(), E>,
    failed: impl Fn(FieldError) -> E,
) -> Result<Render, E> {
    let rows = (BAND_PX / camera.width.max(1)).max(1).next_multiple_of(8);
    let mut whole = Render::empty(camera.width, camera.height);
    for top in (0..camera.height).step_by(rows as usize) {
        keep_going()?;
        let band = field
            .rows(camera, cam_from_world, top..camera.height.min(top + rows))
            .map_err(&failed)?;
        let first = top as usize * camera.width as usize;
        let pixels = first..first + band.rgb.len();
        whole.rgb[pixels.clone()].copy_from_slice(&band.rgb);
        whole.opacity[pixels.clone()].copy_from_slice(&band.opacity);
        whole.depth[pixels].copy_from_slice(&band.depth);
    }
    Ok(whole)
}
