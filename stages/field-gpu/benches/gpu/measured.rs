//! What a benchmark found, as a line of JSON: written where it is measured, read where it is collected.

use marf_field::{Field, ViewDependence};
use marf_field_gpu::{KernelTime, Load, Shape};
use serde::{Deserialize, Serialize};

/// A line of the outcome.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Line {
    /// The kernels of a training.
    Kernels(Kernels),
    /// A picture.
    View(View),
}

/// The kernels of a training with one size of batch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Kernels {
    /// Adapter, driver and digest of the kernels.
    pub device: String,
    /// The field.
    pub field: String,
    /// Samples that a step aims at.
    pub batch_samples: u32,
    /// What the steps that were timed worked on, in the mean.
    pub shape: Shape,
    /// Bytes a second of a copy, read and written ones both counted.
    pub copy_bytes_per_s: f64,
    /// Operations a second of fused multiply-adds, two each.
    pub operations_per_s: f64,
    /// Seconds of a step by the clock.
    pub clock_s: f64,
    /// Samples trained in a second by the clock.
    pub samples_per_s: f64,
    /// Seconds a step that updates of the occupancy took.
    pub update_s: f64,
    /// The slowest first.
    pub kernels: Vec<Kernel>,
}

/// A kernel of a training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Kernel {
    /// Its name.
    pub name: String,
    /// Dispatches a step.
    pub calls: f64,
    /// Seconds a step, by timestamps.
    pub seconds: f64,
    /// Bytes a step that it cannot do without, where these bind it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bytes: Option<f64>,
    /// Operations a step, where these bind it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub operations: Option<f64>,
}

/// A picture of a trained field.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Adapter, driver and digest of the kernels.
    pub device: String,
    /// The field.
    pub field: String,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// What the model of its time is made from.
    pub shape: ViewShape,
    /// Seconds of every run but the first, ascending. Each is copied back to the host.
    pub seconds: Vec<f64>,
}

/// What the kernels of a picture work on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ViewShape {
    /// Steps along a ray, occupied or not.
    pub steps_a_ray: f64,
    /// Levels of the grid.
    pub levels: usize,
    /// Inputs and outputs of the layers of the density network.
    pub density: Vec<[usize; 2]>,
    /// Inputs and outputs of the layers of the colour network.
    pub color: Vec<[usize; 2]>,
}

impl ViewShape {
    /// Returns the shape of a picture of a field.
    pub fn new(field: &Field) -> Self {
        let (config, facts) = (field.config(), field.facts());
        let levels = facts.levels.len();
        let layers = |inputs: usize, width: u32, layers: u32| {
            let width = width as usize;
            let hidden = (1..layers).map(|_| [width, width]);
            std::iter::once([inputs, width])
                .chain(hidden)
                .chain([[width, 16]])
                .collect()
        };
        let directions = match config.view_dependence {
            ViewDependence::On => 16,
            ViewDependence::Off => 0,
        };
        Self {
            steps_a_ray: f64::from(facts.steps_per_ray),
            levels,
            density: layers(levels * config.features as usize, config.density_width, 1),
            color: layers(16 + directions, config.color_width, config.color_layers),
        }
    }
}

impl From<&KernelTime> for Kernel {
    fn from(time: &KernelTime) -> Self {
        Self {
            name: time.name.to_owned(),
            calls: time.calls,
            seconds: time.seconds,
            bytes: match time.load {
                Some(Load::Bytes(bytes)) => Some(bytes),
                _ => None,
            },
            operations: match time.load {
                Some(Load::Operations(operations)) => Some(operations),
                _ => None,
            },
        }
    }
}

impl Kernels {
    /// Returns the seconds of a step by timestamps.
    pub fn step_s(&self) -> f64 {
        self.update_s + self.kernels.iter().map(|kernel| kernel.seconds).sum::<f64>()
    }
}
