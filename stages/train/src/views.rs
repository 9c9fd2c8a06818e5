//! Views that a field is trained on, and the trainer itself.

use std::collections::BTreeMap;

use marf_depth::TargetDetail;
use marf_field::{Config, Derived, Field, PixelDistance, Pixels, Trainer, View, exposure::StartExposure};
use marf_scene::{Camera, Frame, Scene, Tones};
use marf_schema::train::TrainParams;
use marf_stage::{Ctx, StageError};

use crate::{
    TrainError,
    memory::MemoryPlan,
    photos::{PhotoReader, ScaledPhoto},
    split::NamedFrame,
};

/// Separates the id of a photo from the number of a further copy of it.
const COPY: char = '#';

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
        let photo = photo.without_falloff();
        let hidden = (!photo.hidden.is_empty()).then_some(photo.hidden.as_slice());
        let image = Pixels::thinned(photo.image, hidden, plan.run, seed, index as u64);
        (photo.camera, image.with_alpha(&photo.alpha))
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
                format!("{id}{COPY}{}", copy + 1)
            },
            camera,
            cam_from_world: named.frame.cam_from_world,
            image,
            distances: Vec::new(),
        }));
    }
    Ok(views)
}

/// Distances of pixels of training photos, from pairs of them.
#[derive(Default)]
pub(crate) struct Distances(BTreeMap<String, Vec<marf_depth::DistanceSample>>);

impl Distances {
    /// Returns those that pairs of these photos show. No other photo takes part, so that none judges what it has taught.
    ///
    /// # Errors
    /// A photo that cannot be read, or the wish to stop.
    pub fn between(
        ctx: &Ctx<'_>,
        scene: &Scene,
        photos: Vec<Frame>,
        detail: TargetDetail,
    ) -> Result<Self, StageError> {
        let scene = Scene {
            frames: photos,
            ..scene.clone()
        };
        let distances = marf_depth::distances(ctx, &scene, detail)?;
        let ids = scene.frames.into_iter().map(|frame| frame.id);
        Ok(Self(ids.zip(distances).collect()))
    }

    /// Gives each view those of its photo.
    pub fn give_to(&self, mut views: Vec<View>) -> Vec<View> {
        for view in &mut views {
            let of_copy = || self.0.get(view.id.rsplit_once(COPY)?.0);
            let known = self.0.get(&view.id).or_else(of_copy);
            view.distances = known.map_or_else(Vec::new, |known| placed(known, &view.camera));
        }
        views
    }
}

/// Returns distances at the pixels of a camera.
fn placed(known: &[marf_depth::DistanceSample], camera: &Camera) -> Vec<PixelDistance> {
    let pixel = |share: f32, pixels: u32| ((share * pixels as f32) as u32).min(pixels - 1);
    let here = known.iter().map(|one| PixelDistance {
        pixel: [pixel(one.at[0], camera.width), pixel(one.at[1], camera.height)],
        distance: one.distance,
        sigma: one.sigma,
    });
    here.collect()
}

/// What a trainer begins with.
#[derive(Clone, Copy)]
pub(crate) enum Begin<'a> {
    /// Nothing.
    Anew,
    /// The box and the sizes of another training.
    Sized(&'a Derived),
    /// A field.
    From(&'a Field),
}

/// Returns a trainer at step 0, with the seed and on the device of `params`.
///
/// # Errors
/// Those of [`Trainer::new`], or a missing device.
pub(crate) fn new_trainer(
    views: Vec<View>,
    scene: &Scene,
    config: &Config,
    begin: Begin<'_>,
    params: &TrainParams,
) -> Result<Trainer, TrainError> {
    let points: Vec<[f64; 3]> = scene.points.iter().map(|point| point.position).collect();
    let seed = params.seed;
    let trainer = match begin {
        Begin::Anew => Trainer::new(views, &points, config, seed),
        Begin::Sized(derived) => Trainer::with_derived(views, &points, config, seed, derived),
        Begin::From(field) => Trainer::from_field(views, &points, config, seed, field),
    }?;
    let trainer = match (&scene.tones, begin) {
        (Some(tones), Begin::Anew | Begin::Sized(_)) => {
            trainer.with_exposures(&|view| first_exposure(tones, view))?
        }
        _ => trainer,
    };
    Ok(trainer.with_backend(marf_field_gpu::open(&params.device)?)?)
}

/// Returns the exposure of a photo, or of a copy of it, that matched points say. Neutral where they say none.
fn first_exposure(tones: &Tones, view: &str) -> StartExposure {
    let is_it = |id: &str| {
        view.strip_prefix(id)
            .is_some_and(|copy| copy.is_empty() || copy.starts_with(COPY))
    };
    let tone = tones.photos.iter().find(|tone| is_it(&tone.id));
    tone.map_or_else(StartExposure::default, |tone| StartExposure {
        log_gain: tone.log_gain.map(|number| number as f32),
        offset: tone.offset.map(|number| number as f32),
    })
}
