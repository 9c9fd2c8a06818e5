//! The photos of a training, and what each is used for.

use marf_scene::{Frame, Scene};

use super::setup::Settings;
use crate::{
    TrainError,
    split::{NamedFrame, Split, draws, hold_out_by_place, some_of, split},
};

/// The photos of a scene as a training uses them.
pub(super) struct PhotoSet<'a> {
    pub scene: &'a Scene,
    /// Photos to train on and to judge by.
    pub split: Split<'a>,
    /// Training photos held back to watch a target by.
    pub validation: Vec<NamedFrame<'a>>,
    /// How often each training photo is used.
    pub times: Vec<usize>,
}

impl<'a> PhotoSet<'a> {
    /// Splits the photos of a scene. `resample` is the seed with which training photos are drawn.
    ///
    /// # Errors
    /// No photo to train on, to judge by, or to watch a target by.
    pub fn new(scene: &'a Scene, settings: &Settings, resample: Option<u64>) -> Result<Self, TrainError> {
        let mut split = split(scene, settings.holdout, settings.fold)?;
        if let Some(most) = settings.photos {
            split.training = some_of(split.training, most as usize);
        }
        let mut validation = Vec::new();
        if settings.watched {
            let photos = split.training.len();
            let inner = hold_out_by_place(split.training, &scene.points);
            if inner.training.is_empty() || inner.held_out.is_empty() {
                return Err(TrainError::NoValidation { photos });
            }
            (split.training, validation) = (inner.training, inner.held_out);
        }
        let count = split.training.len();
        Ok(Self {
            scene,
            times: resample.map_or_else(|| vec![1; count], |seed| draws(count, seed)),
            split,
            validation,
        })
    }

    /// Returns the training photos that are used.
    pub fn used(&self) -> impl Iterator<Item = &NamedFrame<'a>> {
        let used = self.split.training.iter().zip(&self.times);
        used.filter(|(_, times)| **times > 0).map(|(named, _)| named)
    }

    /// Returns the frames of the training photos that are used.
    pub fn trained_on(&self) -> Vec<&'a Frame> {
        self.used().map(|named| named.frame).collect()
    }

    /// Returns the ids of the training photos, each as often as it is used. `None` if these are all that the scene does not hold out.
    pub fn drawn(&self) -> Option<Vec<String>> {
        let repeated = self.split.training.iter().zip(&self.times);
        let drawn: Vec<String> = repeated
            .flat_map(|(named, times)| std::iter::repeat_n(named.frame.id.clone(), *times))
            .collect();
        let others = self.scene.frames.iter().filter(|frame| !frame.held_out);
        let is_all = drawn.iter().eq(others.map(|frame| &frame.id));
        (!is_all).then_some(drawn)
    }
}
