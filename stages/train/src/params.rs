use marf_field::{Config, Overrides, Quality};
use marf_scene::Scene;
use marf_schema::{train::Fit, tune::BestParams};
use marf_stage::{Ctx, Document, Inputs, StageError};

use crate::TrainError;

/// Returns the keys that are set: those of the input `params`, under `field`.
pub(crate) fn keys(ctx: &Ctx<'_>, inputs: &Inputs, field: &Overrides) -> Result<Overrides, StageError> {
    let best = match inputs.optional(BestParams::OUTPUT) {
        Some(digest) => {
            BestParams::decode(&ctx.get(digest)?).map_err(|error| TrainError::Params(error.to_string()))?
        }
        None => BestParams::default(),
    };
    Ok(best.field.with(field))
}

/// Returns the configuration that keys are laid over; `steps` are those the training is expected to take.
pub(crate) fn config(keys: &Overrides, quality: Quality, fit: Fit, steps: u64) -> Result<Config, StageError> {
    let base = Config {
        steps: Some(steps.max(1)),
        ..fit.config(quality)
    };
    let config = keys.over(&base);
    Ok(config.map_err(|error| TrainError::Params(error.to_string()))?)
}

/// Returns `scale`, or the least whole factor that brings every photo to the size worth training on.
pub(crate) fn scale(scale: Option<u32>, quality: Quality, scene: &Scene) -> u32 {
    let sides = scene
        .frames
        .iter()
        .map(|frame| frame.camera.width.max(frame.camera.height));
    let longest = sides.max().unwrap_or(1);
    scale.unwrap_or_else(|| longest.div_ceil(quality.longest_side_px()).max(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photos_are_shrunk_by_the_least_factor_that_fits() {
        let mut scene = Scene::default();
        assert_eq!(scale(None, Quality::Draft, &scene), 1);
        for (width, height, factor) in [(480, 360, 1), (481, 10, 2), (1440, 1920, 4), (10, 961, 3)] {
            scene.frames = vec![marf_scene::Frame {
                id: String::new(),
                file: String::new(),
                image: marf_cache::Digest::of(b""),
                camera: marf_scene::Camera::pinhole(width, height, 1.0),
                cam_from_world: marf_scene::Pose::identity(),
                held_out: false,
                error_px: None,
            }];
            assert_eq!(scale(None, Quality::Draft, &scene), factor, "{width} x {height}");
            assert_eq!(scale(Some(7), Quality::Draft, &scene), 7);
        }
    }
}
