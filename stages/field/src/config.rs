use std::ops::RangeInclusive;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{FieldError, Gain, Vignetting};

/// Steps along rays are never halved more often.
pub const MOST_HALVINGS: u32 = 6;

/// What a ray gathers behind the last sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Background {
    /// A colour by direction (16 spherical harmonics a channel), learnt from photos without transparency: sky and horizon.
    Direction,
    /// Black: objects in front of nothing.
    Black,
}

/// Which cells of the occupancy grid rays visit at first. Stored fields name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Occupied {
    /// All that some camera sees.
    Seen,
}

/// What shows where surfaces are, while matter is pulled to them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DepthSource {
    /// Sparse points.
    #[default]
    Points,
    /// Sparse points, and distances of pixels from pairs of the photos trained on. Pixels of sky keep their rays empty.
    Pairs,
}

/// Whether the colour of a place depends on the direction it is seen from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ViewDependence {
    /// The colour network sees 16 spherical harmonics of the direction: gloss.
    On,
    /// The colour network does not see the direction, and is smaller: dust and rock.
    Off,
}

/// Hyper-parameters of the field and its training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Levels of the hash grid, 1 to 16. Absent: enough to keep the growth from level to level at 2 or less.
    pub levels: Option<u32>,
    /// Features an entry: 2 or 4. `levels * features` is a multiple of 16.
    pub features: u32,
    /// Binary logarithm of the entries of a level, 8 to 24. Levels with fewer corners are stored densely. Absent: from
    /// the surface and from `steps`.
    pub log2_table: Option<u32>,
    /// Added to the binary logarithm of the table, set by `log2_table` or derived, -4 to 4. A search varies
    /// it. The sum stays in 8 to 24.
    #[serde(skip_serializing_if = "is_zero")]
    pub log2_table_shift: i32,
    /// Cells a side of the coarsest level, 4 to 512.
    pub base_resolution: u32,
    /// Cells a side of the finest level. Absent: from the footprint of a pixel on the scene.
    pub finest_resolution: Option<u32>,
    /// Factor on the cells a side of the finest level, set by `finest_resolution` or derived, in [1/8, 8]. A
    /// search varies it. The cells stay at `base_resolution` or more, and at 8192 or less where a factor
    /// raises them.
    #[serde(skip_serializing_if = "is_one")]
    pub finest_factor: f64,
    /// Neurons in the hidden layer of the density network: 16, 32, 64 or 128.
    // Mock-up after 60 s: 32 gives 21.16 dB, 64 gives 21.12.
    pub density_width: u32,
    /// Neurons in a hidden layer of the colour network: 16, 32, 64 or 128.
    pub color_width: u32,
    /// Hidden layers of the colour network, 1 to 3.
    pub color_layers: u32,
    /// Samples that one step aims at, 256 to 2^20. The number of rays follows from it. Default for a
    /// training with a time limit on a GPU: from its speed, 2^12 to 2^18.
    pub batch_samples: u32,
    /// Most samples of a ray that are trained, approximately, 0 to 4096. 0: all. Once steps along rays were
    /// halved, samples are chosen by weight from those that are visible. With few samples, rays are cheap
    /// and a step has more of them, but surfaces are less exact.
    #[serde(skip_serializing_if = "is_zero")]
    pub ray_samples: u32,
    /// Adam's step size at the start, in (0, 1].
    pub learning_rate: f64,
    /// Adam's step size at the end of the training, as a share of that at the start, in [1e-4, 1]. It falls
    /// by equal factors in the second half, from step 512 at the earliest.
    pub final_rate: f64,
    /// Decay of the running average of the weights in a step, 0 to 0.9999. A field consists of the averaged
    /// weights.
    pub average: f64,
    /// Cells a side of the occupancy grid over the whole contracted box, 16 to 256, a multiple of 4.
    pub occupancy_resolution: u32,
    /// Cells that rays visit at first.
    // Starting from points alone gained nothing next to `depth_weight`: `benches/field.md`.
    pub occupied: Occupied,
    /// Length of a step along the ray at first, as a share of the distance from the camera, in [1/1024, 1/4].
    pub cone: f64,
    /// Shortest step at first, as a share of the box's half side, in [1e-4, 0.5]. It is shorter if matter is
    /// so near that `cone` makes shorter steps there.
    pub min_step: f64,
    /// How often `cone` and `min_step` are halved in training, 0 to 6: in equal parts of nine tenths of it
    /// and after 640 steps each at the earliest. All at once where rays have few samples. Absent: until a
    /// step is at most a pixel long.
    pub halvings: Option<u32>,
    /// Steps after which the box is fitted to the matter that the field has found, and the field restarts in
    /// it. Rounded down to a multiple of 16. 0: never. Absent: an eighth of `steps`, 64 to 512, where they
    /// are 256 or more. Not used if 32 sparse points or more decide the box.
    pub refit_steps: Option<u32>,
    /// Distance of the first sample, as a share of the box's half side, in [1e-4, 10]. Absent: from sparse
    /// points, or from the distances of pairs.
    pub near: Option<f64>,
    /// Distance of the last sample, as a share of the box's half side, larger than `near`, at most 1e6.
    /// Absent: from sparse points, or from the distances of pairs.
    pub far: Option<f64>,
    /// Planned steps of the training: a table is not larger than they fill, and the step size and the length
    /// of steps along rays end with it. Absent: not known. Schedules then behave as with 4,000 steps.
    pub steps: Option<u64>,
    /// Weight of the distortion loss (mip-NeRF 360, arXiv 2111.12077, eq. 15), 0 or more, the same in all
    /// steps. Absent: from the number of photos, growing with the steps if there are many photos.
    pub distortion: Option<f64>,
    /// Weight decay of the tables at the start, in [0, 1]: an entry with a gradient gets this times itself
    /// added to it. The decay falls to 0 with the square of the remaining share of the training. Absent:
    /// from the numbers of photos and of sparse points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub table_decay: Option<f64>,
    /// Weight of the opacity of every sample in the loss, in [0, 0.1]. It removes thin fog, which costs
    /// samples on every ray.
    // After 2,000 steps 0.00003 gained 0.15 dB on the mock-up and 0.07 on the fox, 0.0001 gained 0.31 and lost 0.24: `benches/field.md`.
    pub emptiness: f64,
    /// Weight of the loss that pulls surfaces to what `depth_source` says, in [0, 1]. 0: off. It falls to 0 over
    /// `depth_steps`. It helps most if there are few photos.
    // `benches/field.md`. The squared error of the expected step instead fogs the ray.
    pub depth_weight: f64,
    /// Steps after which nothing pulls any longer, 1 or more. Absent: from `steps` and the number of
    /// photos, at most 1,000.
    pub depth_steps: Option<u32>,
    /// What pulls. Default: `pairs` with fewer than 24 photos to train on, or with 16 steps a photo or more, else `points`.
    #[serde(skip_serializing_if = "is_zero")]
    pub depth_source: DepthSource,
    /// Exposure of single photos. Default: `per_photo_and_offset` if photos differ in the tones of matched points by more than noise, else
    /// `off`.
    pub gain: Gain,
    /// Darkening towards the corners of photos. Default: `per_camera` if matched points surely show it and photos held back agree better for
    /// it, else `off`.
    #[serde(skip_serializing_if = "is_zero")]
    pub vignetting: Vignetting,
    /// Colour behind the last sample. Each ray of a photo with transparency is trained over a random
    /// colour. If all photos have transparency, pictures show black there.
    pub background: Background,
    /// Whether colours depend on the direction of view.
    pub view_dependence: ViewDependence,
}

// Fields that were trained without these keys keep their bytes.
fn is_zero<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

fn is_one(factor: &f64) -> bool {
    *factor == 1.0
}

impl Default for Config {
    fn default() -> Self {
        Self {
            levels: None,
            features: 4,
            log2_table: None,
            log2_table_shift: 0,
            base_resolution: 16,
            finest_resolution: None,
            finest_factor: 1.0,
            density_width: 32,
            color_width: 32,
            color_layers: 1,
            batch_samples: 1 << 15,
            ray_samples: 0,
            learning_rate: 2e-2,
            final_rate: 0.05,
            average: 0.95,
            occupancy_resolution: 128,
            occupied: Occupied::Seen,
            cone: 0.04,
            min_step: 0.03,
            halvings: None,
            refit_steps: None,
            near: None,
            far: None,
            steps: None,
            distortion: None,
            table_decay: None,
            emptiness: 3e-5,
            depth_weight: 1e-2,
            depth_steps: None,
            depth_source: DepthSource::Points,
            gain: Gain::Off,
            vignetting: Vignetting::Off,
            background: Background::Direction,
            view_dependence: ViewDependence::On,
        }
    }
}

/// A rule of a key.
struct Rule {
    key: &'static str,
    value: f64,
    is_kept: bool,
    /// What is allowed.
    range: String,
}

fn rule(key: &'static str, value: impl Into<f64>, is_kept: bool, range: &str) -> Rule {
    Rule {
        key,
        value: value.into(),
        is_kept,
        range: range.to_owned(),
    }
}

/// Returns the rule of a number in a range. An absent number keeps it.
fn between(key: &'static str, value: Option<impl Into<f64>>, range: RangeInclusive<f64>) -> Rule {
    let value = value.map(Into::into);
    let is_kept = value.is_none_or(|value| range.contains(&value));
    let text = format!("{} to {}", range.start(), range.end());
    rule(key, value.unwrap_or_default(), is_kept, &text)
}

/// Returns the rule of the neurons of a hidden layer.
fn width(key: &'static str, width: u32) -> Rule {
    let is_kept = matches!(width, 16 | 32 | 64 | 128);
    rule(key, width, is_kept, "16, 32, 64 or 128")
}

impl Config {
    /// Returns the full base configuration of instant-ngp (arXiv 2201.05989, table 1 and section 4), whatever the
    /// scene: what sizing by the scene is compared with.
    pub fn fixed() -> Self {
        Self {
            levels: Some(16),
            features: 2,
            log2_table: Some(19),
            finest_resolution: Some(2048),
            density_width: 64,
            color_width: 64,
            color_layers: 2,
            near: Some(0.1),
            far: Some(512.0),
            ..Self::default()
        }
    }

    /// Checks that every number is in its documented range.
    ///
    /// # Errors
    /// [`FieldError::Config`] names the key, the value and the range.
    pub fn check(&self) -> Result<(), FieldError> {
        let rules = self.ranges().into_iter().chain(self.other_rules());
        for rule in rules {
            if !rule.is_kept {
                return Err(FieldError::Config {
                    key: rule.key,
                    value: rule.value,
                    range: rule.range,
                });
            }
        }
        Ok(())
    }

    /// Returns the rules of numbers in a range.
    fn ranges(&self) -> [Rule; 16] {
        [
            between("levels", self.levels, 1.0..=16.0),
            between("log2_table", self.log2_table, 8.0..=24.0),
            between("log2_table_shift", Some(self.log2_table_shift), -4.0..=4.0),
            between("base_resolution", Some(self.base_resolution), 4.0..=512.0),
            between("color_layers", Some(self.color_layers), 1.0..=3.0),
            between("batch_samples", Some(self.batch_samples), 256.0..=1_048_576.0),
            between("ray_samples", Some(self.ray_samples), 0.0..=4096.0),
            between("final_rate", Some(self.final_rate), 1e-4..=1.0),
            between("average", Some(self.average), 0.0..=0.9999),
            between("min_step", Some(self.min_step), 1e-4..=0.5),
            between("halvings", self.halvings, 0.0..=f64::from(MOST_HALVINGS)),
            between("near", self.near, 1e-4..=10.0),
            between("distortion", self.distortion, 0.0..=1.0),
            between("table_decay", self.table_decay, 0.0..=1.0),
            between("emptiness", Some(self.emptiness), 0.0..=0.1),
            between("depth_weight", Some(self.depth_weight), 0.0..=1.0),
        ]
    }

    /// Returns the rules that are not of one range.
    fn other_rules(&self) -> [Rule; 12] {
        let near = self.near.unwrap_or(2e-4);
        [
            rule(
                "features",
                self.features,
                matches!(self.features, 2 | 4),
                "2 or 4",
            ),
            rule(
                "levels * features",
                self.levels.map_or(0.0, f64::from) * f64::from(self.features),
                self.levels
                    .is_none_or(|levels| levels.wrapping_mul(self.features).is_multiple_of(16)),
                "a multiple of 16",
            ),
            rule(
                "finest_resolution",
                self.finest_resolution.unwrap_or_default(),
                self.finest_resolution
                    .is_none_or(|finest| (self.base_resolution..=1 << 20).contains(&finest)),
                "base_resolution to 1048576",
            ),
            rule(
                "finest_factor",
                self.finest_factor,
                (0.125..=8.0).contains(&self.finest_factor),
                "1/8 to 8",
            ),
            width("density_width", self.density_width),
            width("color_width", self.color_width),
            rule(
                "occupancy_resolution",
                self.occupancy_resolution,
                (16..=256).contains(&self.occupancy_resolution)
                    && self.occupancy_resolution.is_multiple_of(4),
                "16 to 256, a multiple of 4",
            ),
            rule(
                "learning_rate",
                self.learning_rate,
                self.learning_rate > 0.0 && self.learning_rate <= 1.0,
                "above 0, at most 1",
            ),
            rule(
                "cone",
                self.cone,
                (1.0 / 1024.0..=0.25).contains(&self.cone),
                "1/1024 to 1/4",
            ),
            rule(
                "far",
                self.far.unwrap_or_default(),
                self.far.is_none_or(|far| far > near && far <= 1e6),
                "above `near`, at most 1000000",
            ),
            rule("steps", 0.0, self.steps != Some(0), "1 or more"),
            rule("depth_steps", 0.0, self.depth_steps != Some(0), "1 or more"),
        ]
    }
}
