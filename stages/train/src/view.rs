//! Renders of whole views.

use marf_field::{Field, Render, render_in_bands};
use marf_scene::{Camera, Pose};
use marf_stage::{Ctx, StageError};

use crate::error::field_failed;

/// Renders a view. A request to stop is noticed between its bands.
pub(crate) fn render_view(
    ctx: &Ctx<'_>,
    field: &Field,
    camera: &Camera,
    cam_from_world: &Pose,
) -> Result<Render, StageError> {
    render_in_bands(field, camera, cam_from_world, || ctx.check())?.map_err(field_failed)
}
