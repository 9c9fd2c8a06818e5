//! Incremental mapping: models from the view graph.

use super::input::{MIN_PHOTOS, MapError, MapperInput};
use super::merge::merge_last;
use super::model::Model;
use super::{lens, register};

/// Returns the models that the photos form, the largest first.
///
/// A photo is in at most one model, and may be in none. The result is empty if no pair of photos has both enough
/// matches and enough parallax.
pub fn map(input: &MapperInput<'_>) -> Result<Vec<Model>, MapError> {
    let mut models: Vec<Model> = Vec::new();
    let mut taken = vec![false; input.views.len()];
    while let Some(model) = register::largest_model(input, &taken)? {
        let fresh = model.photos().filter(|&photo| !taken[photo]);
        if fresh.count() < MIN_PHOTOS.min(input.views.len()) {
            break;
        }
        for (taken, pose) in taken.iter_mut().zip(&model.poses) {
            *taken |= pose.is_some();
        }
        models.push(model);
        models = merge_last(input, models)?;
    }
    for model in &mut models {
        lens::choose_lens(input, model)?;
    }
    // A step that was cut short has no result.
    input.check_stop()?;
    models.sort_by_key(|model| (std::cmp::Reverse(model.photos().count()), model.photos().next()));
    Ok(models)
}
