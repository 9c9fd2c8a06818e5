//! What a training learns from, and its state: all that a backend needs to take steps.

use marf_scene::Pose;

use crate::cpu::adam::Bias;
use crate::cpu::march::Steps;
use crate::depth::{Observation, observations};
use crate::frame::{ENOUGH_POINTS, Frame};
use crate::occupancy::Occupancy;
use crate::rng::Fingerprint;
use crate::schedule::{Schedule, refit_step};
use crate::state::State;
use crate::views::{View, check_points, check_views, pixel_offsets};
use crate::weights::Weights;
use crate::{Background, Config, Derived, Facts, FieldError, LevelFacts, Quality, Sizes, background, size};

/// Largest share of its half side at which a box fitted to the matter replaces the old one: the field then
/// restarts.
const SMALLER: f64 = 0.75;
/// Most places of distances that decide a box. More give the same percentiles.
const MOST_SHOWN: usize = 1 << 14;

/// A training: photos, settings, what was derived from them, and the state.
pub struct Training {
    /// Hyper-parameters.
    pub config: Config,
    /// Seed of all random numbers.
    pub seed: u64,
    /// After how many steps it ends: at first the configuration's.
    pub schedule: Schedule,
    /// The photos.
    pub views: Vec<View>,
    /// Poses of the photos' cameras, the other way round.
    pub world_from_cams: Vec<Pose>,
    /// Number of the first kept pixel of every view, and of all at the end.
    pub pixels: Vec<u64>,
    /// The box of the scene.
    pub frame: Frame,
    /// Levels, table, near and far.
    pub sizes: Sizes,
    /// Steps along rays, as often halved as the state says.
    pub march: Steps,
    /// Step after which the box is fitted to the field. `None` where sparse points, or another training, have
    /// decided it.
    pub refit_step: Option<u64>,
    /// Digest of photos, cameras, poses, points that pull, and the box at first: checkpoints of another training have another.
    pub fingerprint: u64,
    /// Sparse points, distances and sky in the views. Empty where they do not pull.
    pub observations: Vec<Observation>,
    /// Corrections of the moments by step count.
    pub bias: Bias,
    /// How often the steps along rays were halved in the field that it starts from. `None` where it starts
    /// from nothing.
    pub halved_before: Option<u32>,
    /// All that changes.
    pub state: State,
}

impl Training {
    /// Returns a training at step 0. `points` are sparse surface points in the world and may be empty: with fewer than 32, places that
    /// distances in half of the photos show decide box and sizes.
    ///
    /// # Errors
    /// See [`FieldError`]: no views, sizes that differ, cameras that are not finite, a key out of range.
    pub fn new(
        views: Vec<View>,
        points: &[[f64; 3]],
        config: &Config,
        seed: u64,
    ) -> Result<Self, FieldError> {
        check(&views, points, config)?;
        let shown = if points.len() < ENOUGH_POINTS {
            shown_places(&views)
        } else {
            Vec::new()
        };
        let (frame, surface) = match Frame::around_shown(&views, &shown) {
            Some(frame) => (frame, shown.as_slice()),
            None => (Frame::derive(&views, points), points),
        };
        frame.check(&views)?;
        let sizes = size::derive(&views, surface, points.len(), config, &frame);
        let derived = Derived::new(&frame, &sizes);
        Ok(Self {
            refit_step: refit_step(config, points),
            ..Self::within(views, points, config, seed, &derived)
        })
    }

    /// As [`Training::new`], in the box and with the sizes of another training. The box then stays as it is.
    ///
    /// # Errors
    /// As [`Training::new`], and a box or a size that cannot be used.
    pub fn with_derived(
        views: Vec<View>,
        points: &[[f64; 3]],
        config: &Config,
        seed: u64,
        derived: &Derived,
    ) -> Result<Self, FieldError> {
        check(&views, points, config)?;
        derived.check(config, &views)?;
        Ok(Self::within(views, points, config, seed, derived))
    }

    /// Returns a training at step 0 whose box is not fitted to the field.
    fn within(views: Vec<View>, points: &[[f64; 3]], config: &Config, seed: u64, derived: &Derived) -> Self {
        let (frame, sizes) = (derived.frame(), derived.sizes.clone());
        let config = &shown_over(config, &views);
        let mut weights = Weights::zeros(config, &sizes);
        weights.randomise(seed);
        if config.background == Background::Direction {
            weights.background = background::fit(&views);
        }
        let march = sizes.steps(config, 0);
        let side = config.occupancy_resolution;
        let occupancy = Occupancy::full(side, &frame, &views);
        let state = State::new(config, &views, weights, occupancy, march.count as f64);
        let pixels = pixel_offsets(&views);
        let observations = if config.depth_weight > 0.0 {
            observations(&views, &pixels, points, &frame, &march)
        } else {
            Vec::new()
        };
        Self {
            refit_step: None,
            schedule: Schedule::once(config.steps.unwrap_or(Quality::Standard.steps())),
            fingerprint: fingerprint(&views, &frame, &observations),
            config: config.clone(),
            seed,
            world_from_cams: views.iter().map(|view| view.cam_from_world.inverse()).collect(),
            pixels,
            views,
            frame,
            sizes,
            march,
            observations,
            bias: Bias::default(),
            halved_before: None,
            state,
        }
    }

    /// Fits box, sizes and occupancy to points of the world at which the field has found matter, and restarts
    /// its tables and networks. Returns whether it did: a box that would not be a quarter smaller stays.
    pub fn refit(&mut self, points: &[[f64; 3]]) -> bool {
        if points.len() < ENOUGH_POINTS {
            return false;
        }
        let steps = self.state.steps;
        let mut frame = Frame::derive(&self.views, points);
        frame.reason = format!(
            "after {steps} steps the field has found matter, whose places count as sparse points: {}",
            frame.reason
        );
        if frame.half_side > SMALLER * self.frame.half_side || frame.check(&self.views).is_err() {
            return false;
        }
        let sizes = size::derive(&self.views, points, points.len(), &self.config, &frame);
        let occupancy = self.state.occupancy.moved(&self.frame, &frame, &self.views);
        let mut placed = self.placed(&sizes, occupancy);
        placed.weights.randomise(self.seed);
        placed
            .weights
            .background
            .clone_from(&self.state.weights.background);
        placed.average = placed.weights.clone();
        self.place(frame, sizes, placed);
        true
    }

    /// Returns the state for a field of other sizes, its tables and networks zero. Steps and exposures
    /// continue.
    pub fn placed(&self, sizes: &Sizes, occupancy: Occupancy) -> State {
        let (config, state) = (&self.config, &self.state);
        let weights = Weights::zeros(config, sizes);
        State {
            steps: state.steps,
            halvings: state.halvings.min(sizes.halvings.value),
            gains: state.gains.clone(),
            gain_moments: state.gain_moments.clone(),
            late_samples_per_ray: state.late_samples_per_ray,
            ..State::new(config, &self.views, weights, occupancy, state.samples_per_ray)
        }
    }

    /// Puts the training into a box. Sessions that were begun before do not see it.
    pub fn place(&mut self, frame: Frame, sizes: Sizes, state: State) {
        let scale = self.frame.half_side / frame.half_side;
        for seen in &mut self.observations {
            [seen.t, seen.sigma] = [seen.t, seen.sigma].map(|length| (f64::from(length) * scale) as f32);
        }
        self.march = sizes.steps(&self.config, state.halvings);
        (self.frame, self.sizes, self.state) = (frame, sizes, state);
    }

    /// Returns whether the training can be in this box after a number of steps: the box at first, or a
    /// smaller one once it was fitted.
    pub fn may_hold(&self, frame: &Frame, steps: u64) -> bool {
        let is_fitted = self.refit_step.is_some_and(|at| at <= steps);
        *frame == self.frame
            || (is_fitted && frame.half_side <= SMALLER * self.frame.half_side && frame.half_side > 0.0)
    }

    /// Returns the numbers that decided the size of the field.
    pub fn facts(&self) -> Facts {
        let weights = &self.state.weights;
        let levels = weights.shapes.iter().map(|shape| LevelFacts {
            resolution: shape.resolution,
            entries: shape.entries,
            dense: shape.dense,
        });
        let parameters: usize = weights.tensors().iter().map(|(_, values)| values.len()).sum();
        Facts {
            origin: self.frame.origin,
            half_side: self.frame.half_side,
            box_reason: self.frame.reason.clone(),
            near: self.sizes.near.value * self.frame.half_side,
            far: self.sizes.far.value * self.frame.half_side,
            steps_per_ray: self.march.count as u32,
            halvings: self.state.halvings,
            levels: levels.collect(),
            sizes: self.sizes.clone(),
            parameters: parameters as u64,
            seen_share: self.state.occupancy.seen_share(),
            occupied_share: self.state.occupancy.bits.share(),
            steps: self.state.steps,
            transparent_photos: self
                .views
                .iter()
                .filter(|view| view.image.is_transparent())
                .count() as u64,
        }
    }
}

/// Returns places in the world that distances of pixels show, spread over the photos. None if less than half of the photos have any.
fn shown_places(views: &[View]) -> Vec<[f64; 3]> {
    let has_any = |view: &&View| view.distances.iter().any(|one| one.distance.is_finite());
    if 2 * views.iter().filter(has_any).count() < views.len() {
        return Vec::new();
    }
    let all: usize = views.iter().map(|view| view.distances.len()).sum();
    // Odd, so that it takes all columns of a lattice in turn.
    let stride = all.div_ceil(MOST_SHOWN) | 1;
    let each = views
        .iter()
        .flat_map(|view| view.distances.iter().map(|one| view.place_of(one)));
    each.step_by(stride).flatten().collect()
}

/// Returns the configuration with the background that pictures show: black where every photo is transparent somewhere, which then says
/// nothing of a background.
fn shown_over(config: &Config, views: &[View]) -> Config {
    let are_cut_out = views.iter().all(|view| view.image.is_transparent());
    Config {
        background: if are_cut_out {
            Background::Black
        } else {
            config.background
        },
        ..config.clone()
    }
}

/// Checks everything that a training starts from but its box.
fn check(views: &[View], points: &[[f64; 3]], config: &Config) -> Result<(), FieldError> {
    config.check()?;
    check_views(views)?;
    check_points(points)
}

/// Returns a digest of photos, cameras, poses, points that pull, and the box.
fn fingerprint(views: &[View], frame: &Frame, observations: &[Observation]) -> u64 {
    let mut sum = Fingerprint::default();
    for view in views {
        let camera = &view.camera;
        sum.add([camera.width.into(), camera.height.into()]);
        let lens = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px];
        let distortion = [camera.k1, camera.k2, camera.p1, camera.p2];
        sum.add(lens.iter().chain(&distortion).map(|number| number.to_bits()));
        let pose: [[f64; 4]; 3] = view.cam_from_world.into();
        sum.add(pose.as_flattened().iter().map(|number| number.to_bits()));
        sum.add(view.image.words());
        sum.add(view.image.alpha().iter().map(|alpha| u64::from(*alpha)));
    }
    let numbers = frame.origin.iter().chain([&frame.half_side]);
    sum.add(numbers.map(|number| number.to_bits()));
    for observation in observations {
        sum.add([observation.pixel, observation.t.to_bits().into()]);
        // Sparse points have none, and keep the digests of states from before there were others.
        if observation.sigma > 0.0 {
            sum.add([observation.sigma.to_bits().into()]);
        }
    }
    sum.0
}
