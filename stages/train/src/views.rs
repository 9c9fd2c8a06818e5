//! Views that a field is trained on, and the trainer itself.

use marf_field::{Config, Derived, Device, Pixels, Trainer, View};
use marf_scene::Scene;
use marf_stage::StageError;

use crate::{
    TrainError,
    memory::MemoryPlan,
    photos::{PhotoReader, ScaledPhoto},
    split::NamedFrame,
};

/// Returns views of training photos, each as often as `times` says.
///
/// Of every run of `plan.run` pixels one is kept, drawn by `seed` and the photo's place among the training photos.
pub(crate) fn training_views(
    photos: &PhotoReader<'_>,
    training: &[NamedFrame<'_>],
    times: &[usize],
    plan: MemoryPlan,
    seed: u64,
) -> Result<Vec<View>, StageError> {
    let thinned = |index: usize, photo: ScaledPhoto| {
        let hidden = (!photo.hidden.is_empty()).then_some(photo.hidden.as_slice());
        let image = Pixels::thinned(photo.image, hidden, plan.run, seed, index as u64);
        (photo.camera, image)
    };
    let photos = photos.map(training, plan.at_once, thinned)?;
    let mut views = Vec::with_capacity(times.iter().sum());
    for ((named, (camera, image)), times) in training.iter().zip(photos).zip(times) {
        let id = &named.frame.id;
        let copies = std::iter::repeat_n(image, *times);
        views.extend(copies.enumerate().map(|(copy, image)| View {
            id: if copy == 0 {
                id.clone()
            } else {
                format!("{id}#{}", copy + 1)
            },
            camera,
            cam_from_world: named.frame.cam_from_world,
            image,
        }));
    }
    Ok(views)
}

/// Returns a trainer at step 0, in the box and with the sizes of another training where they are given.
pub(crate) fn new_trainer(
    views: Vec<View>,
    scene: &Scene,
    config: &Config,
    seed: u64,
    derived: Option<&Derived>,
    device: &Device,
) -> Result<Trainer, TrainError> {
    let points: Vec<[f64; 3]> = scene.points.iter().map(|point| point.position).collect();
    let trainer = match derived {
        Some(derived) => Trainer::with_derived(views, &points, config, seed, derived),
        None => Trainer::new(views, &points, config, seed),
    };
    Ok(trainer?.on(device)?)
}
