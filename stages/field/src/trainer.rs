use std::sync::Arc;

use crate::backend::{Backend, Session, Step};
use crate::cpu_backend::Cpu;
use crate::exposure::StartExposure;
use crate::model::Model;
use crate::surface::surface_points;
use crate::training::Training;
use crate::{Config, Derived, Field, FieldError, PhotoHistory, PhotoRecord, Schedule, View};

/// Trains a field on a set of views.
pub struct Trainer {
    /// The training as of the last time that it was brought back from the backend.
    pub training: Training,
    pub(crate) backend: Arc<dyn Backend>,
    /// The training where the backend has it.
    pub session: Box<dyn Session>,
    /// Results of the steps that no call has reported.
    pub(crate) untold: Step,
}

impl Trainer {
    /// Returns a trainer at step 0, on the CPU.
    ///
    /// `points` are sparse surface points in the world. They may be empty.
    ///
    /// # Errors
    /// See [`FieldError`]: no views, sizes that differ, cameras that are not finite, a key out of range.
    pub fn new(
        views: Vec<View>,
        points: &[[f64; 3]],
        config: &Config,
        seed: u64,
    ) -> Result<Self, FieldError> {
        let training = Training::new(views, points, config, seed)?;
        Self::from_training(training, Arc::new(Cpu::best()))
    }

    /// As [`Trainer::new`], in the box and with the sizes that another training of the scene derived. The box
    /// then stays as it is.
    ///
    /// # Errors
    /// As [`Trainer::new`], and a box or a size that cannot be used.
    pub fn with_derived(
        views: Vec<View>,
        points: &[[f64; 3]],
        config: &Config,
        seed: u64,
        derived: &Derived,
    ) -> Result<Self, FieldError> {
        let training = Training::with_derived(views, points, config, seed, derived)?;
        Self::from_training(training, Arc::new(Cpu::best()))
    }

    /// As [`Trainer::with_derived`], in the box and with the sizes of `field`, and from its weights and its
    /// occupancy. Moments are zero, and exposures of new photos neutral.
    ///
    /// # Errors
    /// As [`Trainer::with_derived`], and a configuration that needs tensors which the field does not have.
    pub fn from_field(
        views: Vec<View>,
        points: &[[f64; 3]],
        config: &Config,
        seed: u64,
        field: &Field,
    ) -> Result<Self, FieldError> {
        let mut training = Training::with_derived(views, points, config, seed, &field.derived())?;
        training.start_from(field)?;
        Self::from_training(training, Arc::new(Cpu::best()))
    }

    /// Gives the photos their first exposures, by their ids, where photos have gains and offsets of their own. For step 0.
    ///
    /// # Errors
    /// As [`Trainer::with_backend`].
    pub fn with_exposures(mut self, exposure: &dyn Fn(&str) -> StartExposure) -> Result<Self, FieldError> {
        let views = self.training.views.iter();
        let exposures = views.map(|view| exposure(&view.id)).collect();
        self.training.start_exposures(exposures);
        Self::from_training(self.training, self.backend)
    }

    /// Returns a trainer of a training on a backend.
    ///
    /// # Errors
    /// A device that lacks something or has too little memory.
    pub fn from_training(mut training: Training, backend: Arc<dyn Backend>) -> Result<Self, FieldError> {
        Ok(Self {
            session: backend.clone().begin(&mut training)?,
            training,
            backend,
            untold: Step::default(),
        })
    }

    /// Moves the training to a backend. All further steps are taken there.
    ///
    /// # Errors
    /// A device that lacks something or has too little memory.
    pub fn with_backend(mut self, backend: Arc<dyn Backend>) -> Result<Self, FieldError> {
        self.sync()?;
        Ok(Self {
            untold: self.untold,
            ..Self::from_training(self.training, backend)?
        })
    }

    /// Takes one optimiser step on the CPU. On a GPU it steps to the next multiple of 16, at most `most`, at
    /// least one.
    ///
    /// Reports the steps that no call has reported. On the CPU these are this one. On a GPU they are those of
    /// the call before, and the GPU keeps working while the host reads. [`Trainer::settle`] reports the rest.
    ///
    /// If no sparse points have decided the box, it is fitted once to the matter that the field has found.
    /// The field then restarts in it.
    ///
    /// On a GPU all steps of one call have as many rays: a training that is cut elsewhere than at multiples of 16
    /// learns other bytes than one that is not.
    ///
    /// # Errors
    /// [`FieldError::NotFinite`]. The trainer then still holds the state before the named step.
    /// [`FieldError::Gpu`] where the device failed.
    pub fn advance(&mut self, most: u64) -> Result<Step, FieldError> {
        let step = self.session.advance(&mut self.training, most)?;
        self.untold = self.untold.and(step);
        if self.training.refit_step == Some(self.training.state.steps) {
            self.refit()?;
        }
        Ok(std::mem::take(&mut self.untold))
    }

    /// Waits for all steps that were taken, and reports those that no call has reported.
    ///
    /// # Errors
    /// As [`Trainer::advance`].
    pub fn settle(&mut self) -> Result<Step, FieldError> {
        let step = self.session.settle(&mut self.training)?;
        Ok(std::mem::take(&mut self.untold).and(step))
    }

    /// Fits the box to where the field has found matter.
    fn refit(&mut self) -> Result<(), FieldError> {
        let points = surface_points(&self.field()?, &self.training.views)?;
        if self.training.refit(&points) {
            self.session = self.backend.clone().begin(&mut self.training)?;
        }
        Ok(())
    }

    /// Brings the state back from where the training runs.
    ///
    /// # Errors
    /// A GPU that failed.
    pub fn sync(&mut self) -> Result<(), FieldError> {
        self.untold = self.settle()?;
        self.session.download(&mut self.training.state)
    }

    /// Changes the planned end to `steps`, at least one step from now. Step size and length of steps along
    /// rays follow. Sizes and weights stay as they are.
    pub fn plan(&mut self, steps: u64) {
        self.training.schedule.plan(self.training.state.steps, steps);
    }

    /// Returns after how many steps the training ends, as it was planned so far.
    pub fn schedule(&self) -> &Schedule {
        &self.training.schedule
    }

    /// Returns how often the steps along rays will be halved until the training ends as planned: renders then take longer.
    pub fn halvings_left(&self) -> u32 {
        let training = &self.training;
        let end = training.schedule.steps();
        training.halvings_due(end).saturating_sub(training.state.halvings)
    }

    /// Returns how often the steps along rays are halved at most: once in [`STEPS_A_HALVING`](crate::STEPS_A_HALVING) steps.
    pub fn most_halvings(&self) -> u32 {
        self.training.sizes.halvings.value
    }

    /// Takes over the plans of another training: step size and length of steps along rays are then as there.
    pub fn follow(&mut self, schedule: Schedule) {
        self.training.schedule = schedule;
    }

    /// Returns the optimiser steps taken.
    pub fn steps(&self) -> u64 {
        self.training.state.steps
    }

    /// Returns the field as of now. It renders where the training runs.
    ///
    /// # Errors
    /// A GPU that failed.
    pub fn field(&mut self) -> Result<Field, FieldError> {
        self.sync()?;
        let training = &self.training;
        let model = Model::new(
            training.config.clone(),
            training.frame.clone(),
            training.facts(),
            training.state.average.clone(),
            training.state.occupancy.bits.clone(),
        );
        Field::new(model, self.backend.clone())
    }

    /// Returns the history of this training's photos for a later training.
    ///
    /// # Errors
    /// A GPU that failed.
    pub fn learnt(&mut self, metres_per_unit: Option<f64>) -> Result<PhotoHistory, FieldError> {
        self.sync()?;
        let training = &self.training;
        let photos = training
            .views
            .iter()
            .enumerate()
            .map(|(view, photo)| PhotoRecord {
                id: photo.id.clone(),
                cam_from_world: photo.cam_from_world,
                exposure: training.exposure(view),
            });
        let mut photos: Vec<PhotoRecord> = photos.collect();
        photos.sort_by(|a, b| a.id.cmp(&b.id));
        Ok(PhotoHistory {
            metres_per_unit,
            photos,
        })
    }
}
