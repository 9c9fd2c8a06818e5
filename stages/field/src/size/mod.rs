//! The size of a field: near, far, levels and table, each with the number that decided it.

mod choice;
mod detail;
mod grid;
mod pulls;

pub use pulls::FEW_PHOTOS;
mod rays;

use serde::{Deserialize, Serialize};

use crate::config::MOST_HALVINGS;
use crate::cpu::march::Steps;
use crate::distances::Depths;
use crate::frame::{FAR, Frame, MOST_FINEST};
use crate::{Config, FieldError, View};
pub use choice::Choice;
use detail::detail;
use grid::{finest, levels, log2_table, scaled, surface_cells};
use pulls::{depth_steps, distortion, table_decay};
use rays::{NEAR, NEARER, far, halvings, near};

/// The sizes of a field, as the scene or a key of the configuration decides them. The box is a [`Frame`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sizes {
    /// Distance of the first sample from the camera, half sides of the box.
    pub near: Choice<f64>,
    /// Distance of the last sample from the camera, half sides.
    pub far: Choice<f64>,
    /// Cells a side of the finest level, over the whole contracted box.
    pub finest: Choice<u32>,
    /// Levels of the grid.
    pub levels: Choice<u32>,
    /// Cells of the finest level that the surface passes through.
    pub surface_cells: Choice<u64>,
    /// Share of them that its detail in the photos asks for: 1 where every pixel differs from its neighbours.
    pub detail: Choice<f64>,
    /// Binary logarithm of the most entries of a level.
    pub log2_table: Choice<u32>,
    /// Times that the steps along rays are halved in training, at most.
    pub halvings: Choice<u32>,
    /// Weight of the distortion loss at the start and at the end of the training. Between, it follows the
    /// square of the share that is done.
    pub distortion: Choice<[f64; 2]>,
    /// Steps after which sparse points and distances of pixels no longer pull.
    pub depth_steps: Choice<u32>,
    /// Pull of the tables to zero at the start, see [`Config::table_decay`].
    pub table_decay: Choice<f64>,
}

/// Derives all sizes. A key that is set wins over the scene.
///
/// `points`: points of surfaces, world units. Fewer than 32, or points that no camera sees, count as none. `sparse`: how many of them were
/// matched one by one. Those of distances lie closely and say nothing of how well photos overlap.
/// `frame`: the box of both. Every number is finite, `near` is below `far`, whatever the points are.
pub fn derive(views: &[View], points: &[[f64; 3]], sparse: usize, config: &Config, frame: &Frame) -> Sizes {
    let depths = Depths::seen(views, points, frame);
    let finest = finest(config, &depths, frame, views);
    let surface = if depths.is_ok() { points } else { &[] };
    let surface_cells = surface_cells(views, surface, frame, finest.value);
    let detail = detail(views, surface);
    Sizes {
        near: near(config, &depths),
        far: far(config, &depths),
        levels: levels(config, finest.value),
        log2_table: log2_table(config, surface_cells.value, detail.value),
        halvings: halvings(config, views),
        distortion: distortion(config, views.len(), depths.is_ok()),
        depth_steps: depth_steps(config, views, sparse),
        table_decay: table_decay(config, views.len(), sparse),
        finest,
        surface_cells,
        detail,
    }
}

impl Sizes {
    /// Returns the largest sizes that any scene asks for under these keys.
    pub fn most(config: &Config) -> Self {
        let any = "any scene";
        let finest = config.finest_resolution.unwrap_or(MOST_FINEST);
        let finest = scaled(Choice::new(finest, any), config).value;
        Self {
            near: Choice::new(NEAR, any),
            far: Choice::new(FAR, any),
            finest: Choice::new(finest.max(config.base_resolution), any),
            levels: levels(config, finest),
            surface_cells: Choice::new(u64::MAX, any),
            detail: Choice::new(1.0, any),
            log2_table: log2_table(config, u64::MAX, 1.0),
            halvings: Choice::new(0, any),
            distortion: Choice::new([0.0; 2], any),
            depth_steps: Choice::new(1, any),
            table_decay: Choice::new(0.0, any),
        }
    }

    /// Returns the table for the same scene in a training of this many steps.
    pub fn log2_table_after(&self, config: &Config, steps: u64) -> u32 {
        let config = Config {
            steps: Some(steps),
            ..config.clone()
        };
        log2_table(&config, self.surface_cells.value, self.detail.value).value
    }

    /// Returns the steps along rays after a number of halvings.
    ///
    /// The shortest step is `min_step`, or that of `cone` at the nearest matter if that is less. Close-ups
    /// get steps of as many pixels as all else.
    pub fn steps(&self, config: &Config, halvings: u32) -> Steps {
        let share = 0.5_f64.powi(halvings.min(MOST_HALVINGS) as i32);
        let nearest = self.near.value / NEARER;
        let shortest = config.min_step.min(config.cone * nearest) * share;
        let cone = config.cone * share;
        Steps::new(self.near.value, self.far.value, shortest, cone)
    }

    /// Checks that these sizes, which another program may have written, can be used.
    pub fn check(&self, config: &Config) -> Result<(), FieldError> {
        let finest = self.finest.value;
        if finest < config.base_resolution || finest > 1 << 20 {
            let value = f64::from(finest);
            let range = "base_resolution to 1048576".to_owned();
            return Err(FieldError::Config {
                key: "finest",
                value,
                range,
            });
        }
        let (near, far) = (self.near.value, self.far.value);
        if !(near > 0.0 && far > near && far.is_finite()) {
            let range = "above 0 and below `far`".to_owned();
            return Err(FieldError::Config {
                key: "near",
                value: near,
                range,
            });
        }
        let [first, last] = self.distortion.value;
        for (key, value) in [
            ("distortion", first),
            ("distortion", last),
            ("table_decay", self.table_decay.value),
        ] {
            if !(0.0..=1.0).contains(&value) {
                let range = "0 to 1".to_owned();
                return Err(FieldError::Config { key, value, range });
            }
        }
        let keys = Config {
            levels: Some(self.levels.value),
            log2_table: Some(self.log2_table.value),
            halvings: Some(self.halvings.value),
            depth_steps: Some(self.depth_steps.value),
            ..config.clone()
        };
        keys.check()
    }
}
