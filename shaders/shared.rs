//! Texts that kernels share.

/// Number of a thread in a folded dispatch.
pub(crate) const FLAT: &str = include_str!("shared/flat.wgsl");
/// Corners around a point.
pub(crate) const GRID: &str = include_str!("shared/grid.wgsl");
/// Which levels a dispatch works on.
pub(crate) const PART: &str = include_str!("shared/part.wgsl");
/// From a sample's gradient to 8 entries.
pub(crate) const SCATTERED: &str = include_str!("shared/spread.wgsl");
/// Quanta from words.
pub(crate) const QUANTA: &str = include_str!("shared/quanta.wgsl");
/// A level's fixed point, marked by many threads.
pub(crate) const LEVEL_MARKS: &str = include_str!("shared/level_marks.wgsl");
/// A level's fixed point.
pub(crate) const LEVEL_SCALE: &str = include_str!("shared/level_scale.wgsl");
/// Whether a number ran away.
pub(crate) const FAULTS: &str = include_str!("shared/faults.wgsl");
/// Structs of the occupancy grid.
pub(crate) const FILLING: &str = include_str!("shared/filling.wgsl");

/// Own exponential functions, for kernels and their tests.
pub const MATH: &str = include_str!("shared/math.wgsl");

/// Streams of random numbers, for kernels and their tests.
pub const RNG: &str = include_str!("shared/rng.wgsl");

/// A camera and the rays behind its pixels, for kernels and their tests.
pub const CAMERA: &str = include_str!("shared/camera.wgsl");

/// What a ray is compared with.
pub(crate) const TARGET: &str = include_str!("shared/target.wgsl");

/// What changes with every step of training.
pub(crate) const STEP: &str = include_str!("shared/step.wgsl");

/// Sizes and limits of a walk along rays.
pub(crate) const WALK: &str = include_str!("shared/walk.wgsl");

/// Sizes and rates of the kernels of exposures.
pub(crate) const EXPOSED: &str = include_str!("shared/exposed.wgsl");
