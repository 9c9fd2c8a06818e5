//! Trained fields: search of parameters, training, evaluation, renders and uncertainty maps.
//!
//! Eight stages: `tune`, `train`, `partial` (the first steps of a training), `folds` (judges scenes of few photos), `evaluate`, `render`,
//! `bootstrap` and `video`. They share how photos are read, split, scored and written. Invariant: what a node answers depends on photos, cameras,
//! parameters and seed; the clock decides only when a checkpoint is kept and, with a budget, the schedule of a training, which the
//! setup then holds. Held-out photos never reach a training step.

mod bootstrap;
mod checkpoint;
mod child;
mod error;
mod evaluate;
mod folds;
mod io;
mod memory;
mod photos;
mod random;
mod render;
mod scoring;
mod settings;
mod split;
mod train;
mod tune;
mod video;
mod view;
mod views;

pub use bootstrap::Bootstrap;
pub use error::TrainError;
pub use evaluate::Evaluate;
pub use folds::Folds;
pub use render::Render;
pub use train::{Partial, Train};
pub use tune::Tune;
pub use video::Video;

/// Implements [`marf_stage::Stage`] for a stage with `params.device` that uses all threads; `$work` is its variant of
/// [`marf_stage::Work`].
macro_rules! stage_on_device {
    ($stage:ty, $work:ident) => {
        impl marf_stage::Stage for $stage {
            fn params(&self) -> serde_json::Value {
                marf_stage::key_params(&self.params, &["device"])
            }

            fn work(&self) -> marf_stage::Work<'_> {
                marf_stage::Work::$work(self)
            }

            fn threads(&self) -> marf_stage::Threads {
                marf_stage::Threads::All
            }

            fn backend_id(&self) -> Option<String> {
                self.params.device.backend_id()
            }

            fn backend_id_on(&self, gpu: Option<&str>) -> Result<Option<String>, marf_stage::StageError> {
                self.params
                    .device
                    .backend_id_on(gpu)
                    .map_err(marf_stage::StageError::new)
            }
        }
    };
}
pub(crate) use stage_on_device;
