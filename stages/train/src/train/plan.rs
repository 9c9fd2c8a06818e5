//! Plan of a training before its first step.

use std::time::Instant;

use marf_cache::Digest;
use marf_field::{DepthSource, Trainer};
use marf_scene::{Camera, Scene};
use marf_schema::train::{Holdout, TrainParams};
use marf_stage::{Ctx, Define, Inputs, StageError};

use super::{
    photo_set::PhotoSet,
    planner::{Planner, TrainingTime, slower},
    setup::{Settings, target_detail},
    start::Start,
};
use crate::{
    TrainError,
    checkpoint::identity,
    memory::MemoryPlan,
    photos::PhotoReader,
    scoring::{JudgedPhotos, mean_psnr},
    split::{NamedFrame, spread},
    views::{Begin, Distances},
};

/// Longest side of the photos that judging is measured on, pixels.
const MEASURED_SIDE_PX: u32 = 96;

/// Plan of a training before its first step.
pub(super) struct Plan<'a> {
    pub photos: PhotoSet<'a>,
    /// Of pixels of the training photos. Empty where none are to pull.
    pub distances: Distances,
    pub settings: Settings,
    pub memory: MemoryPlan,
    pub judging: JudgingPlan,
    pub start: Start,
    /// What its checkpoints are of.
    pub identity: Digest,
    /// The time that it may take, once a pilot has measured the device.
    pub time: Option<TrainingTime>,
}

/// By which photos a field is judged.
#[derive(Debug, Clone, Copy)]
pub(super) struct JudgingPlan {
    /// Whole factor by which they are shrunk: as those trained on, unless a time chooses these.
    pub scale: u32,
    /// Which of those held out.
    pub photos: JudgedPhotos,
}

impl<'a> Plan<'a> {
    /// Reads everything that a training depends on, and decides all but its time.
    ///
    /// # Errors
    /// Inputs that cannot be used, a scene without photos to train on or to judge by, too little memory.
    pub fn new<S: Define>(
        ctx: &Ctx<'_>,
        stage: &S,
        params: &TrainParams,
        inputs: &Inputs,
        scene: &'a Scene,
    ) -> Result<Self, StageError> {
        let mut settings = Settings::resolve(ctx, params, inputs, scene)?;
        let photos = PhotoSet::new(scene, &settings, params.resample)?;
        settings.choose_depth_source(params, photos.split.training.len());
        let start = Start::decide(ctx, params, inputs, &photos, &mut settings)?;
        let distances = match settings.config.depth_source {
            DepthSource::Points => Distances::default(),
            DepthSource::Pairs => {
                let frames = photos.trained_on().into_iter().cloned().collect();
                let detail = target_detail(photos.split.training.len());
                ctx.timed("depth", || Distances::between(ctx, scene, frames, detail))?
            }
        };
        let judging = JudgingPlan {
            scale: params.judged_scale.unwrap_or(settings.scale),
            photos: JudgedPhotos {
                most: params.judged_photos.map(|photos| photos as usize),
                until: params.within.map(|wait| ctx.began + wait.duration()),
            },
        };
        Ok(Self {
            memory: settings.plan_memory(&photos.split, &photos.times, judging.scale)?,
            identity: identity(stage, inputs, &settings.length()),
            photos,
            distances,
            settings,
            judging,
            start,
            time: None,
        })
    }

    /// Plans for photos of another size.
    ///
    /// # Errors
    /// Photos that do not fit the memory.
    pub fn shrink_by(&mut self, scale: u32) -> Result<(), TrainError> {
        self.settings.scale = scale;
        let PhotoSet { split, times, .. } = &self.photos;
        self.memory = self.settings.plan_memory(split, times, self.judging.scale)?;
        Ok(())
    }

    /// Returns the planner of the training.
    pub fn planner<'r>(&self) -> Planner<'r> {
        let mut planner = Planner::new(self.settings.schedule.clone());
        planner.until = self.settings.until;
        planner.time = self.time;
        planner
    }

    /// Returns some of the photos that are trained on, where the photos of the final metric are held out.
    pub fn seen(&self) -> Option<Vec<NamedFrame<'a>>> {
        let is_quick = self.judging.photos != JudgedPhotos::ALL;
        if is_quick || self.settings.holdout != Holdout::Test || self.settings.fold.is_some() {
            return None;
        }
        let used: Vec<&NamedFrame<'a>> = self.photos.used().collect();
        let seen = spread(used.len(), self.photos.split.held_out.len());
        Some(seen.map(|index| used[index].clone()).collect())
    }

    /// Returns the start of its trainer.
    pub fn begin(&self) -> Begin<'_> {
        match (&self.start.field, &self.settings.given) {
            (Some(field), _) => Begin::From(field),
            (None, Some(given)) => Begin::Sized(&given.derived),
            (None, None) => Begin::Anew,
        }
    }

    /// Returns the rays of a photo that the field will be judged by.
    pub fn judged_rays(&self) -> f64 {
        let first = &self.photos.split.held_out[0].frame.camera;
        rays(&first.box_reduced(self.judging.scale))
    }

    /// Estimates the seconds that judging a photo will take. Held-out photos are judged now at a small size. The time is scaled to their
    /// full size and to the shorter steps of the end.
    ///
    /// # Errors
    /// A photo that cannot be read, a field that cannot be rendered.
    pub fn photo_s(
        &self,
        ctx: &Ctx<'_>,
        photos: &PhotoReader<'_>,
        trainer: &mut Trainer,
    ) -> Result<f64, StageError> {
        let held_out = &self.photos.split.held_out;
        let photos = &photos.at(self.photos.scene, self.judging.scale);
        let both = photos.map(held_out, self.memory.at_once, |_, photo| {
            (photo.camera, photo.thinned_to(MEASURED_SIDE_PX))
        })?;
        let whole: f64 = both.iter().map(|(camera, _)| rays(camera)).sum();
        let small: f64 = both.iter().map(|(_, small)| rays(&small.camera)).sum();
        let small_photos = both.into_iter().map(|(_, small)| small);
        let pairs: Vec<_> = held_out.iter().cloned().zip(small_photos).collect();
        let field = trainer.field().map_err(TrainError::from)?;
        let began = Instant::now();
        mean_psnr(ctx, &field, &pairs)?;
        let slower = slower(trainer.halvings_left());
        Ok(began.elapsed().as_secs_f64() * whole / small * slower / held_out.len() as f64)
    }
}

fn rays(camera: &Camera) -> f64 {
    f64::from(camera.width) * f64::from(camera.height)
}
