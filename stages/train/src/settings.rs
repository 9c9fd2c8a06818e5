use marf_field::{Config, Overrides};
use marf_scene::Scene;
use marf_schema::{train::Fit, tune::BestParams};
use marf_stage::{Ctx, Document, Inputs, StageError};

use crate::TrainError;

/// Returns the keys of the field that are set: `field` laid over those of the input `params`.
pub(crate) fn field_keys(ctx: &Ctx<'_>, inputs: &Inputs, field: &Overrides) -> Result<Overrides, StageError> {
    let best = match inputs.optional(BestParams::OUTPUT) {
        Some(digest) => {
            BestParams::decode(&ctx.get(digest)?).map_err(|error| TrainError::Params(error.to_string()))?
        }
        None => BestParams::default(),
    };
    Ok(best.field.with(field))
}

/// Returns the configuration of a field: `keys` laid over that of `fit` for a training of `steps`.
pub(crate) fn field_config(keys: &Overrides, fit: Fit, steps: u64) -> Result<Config, StageError> {
    let base = Config {
        steps: Some(steps.max(1)),
        ..fit.config()
    };
    let config = keys.over(&base);
    Ok(config.map_err(|error| TrainError::Params(error.to_string()))?)
}

/// Returns the least whole factor that brings the longest side of every photo to at most `side_px`.
pub(crate) fn scale_to(side_px: u32, scene: &Scene) -> u32 {
    let sides = scene
        .frames
        .iter()
        .map(|frame| frame.camera.width.max(frame.camera.height));
    let longest = sides.max().unwrap_or(1);
    longest.div_ceil(side_px.max(1)).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photos_are_shrunk_by_the_least_factor_that_fits() {
        let mut scene = Scene::default();
        let side_px = marf_field::Quality::LONGEST_SIDE_PX;
        assert_eq!(scale_to(side_px, &scene), 1);
        for (width, height, factor) in [(480, 360, 1), (481, 10, 2), (1440, 1920, 4), (10, 961, 3)] {
            scene.frames = vec![marf_scene::Frame {
                id: String::new(),
                file: String::new(),
                image: marf_cache::Digest::from_content(b""),
                camera: marf_scene::Camera::pinhole(width, height, 1.0),
                cam_from_world: marf_scene::Pose::identity(),
                held_out: false,
                mask: None,
                error_px: None,
            }];
            assert_eq!(scale_to(side_px, &scene), factor, "{width} x {height}");
        }
    }
}
