//! WGSL kernels of marf and their uniforms. One kernel a file, each with its contract at the head.
//!
//! Invariants: every kernel parses and validates in naga, with no capability beyond core WebGPU unless its
//! contract says so. No place, size or rate is written in both Rust and WGSL. Rust writes it into
//! [`constants`], the head or a uniform, and a test compares every field of every uniform by name, type and
//! offset.

mod net_structs;
mod nets;
mod shader;
mod shared;
mod structs;

pub use net_structs::*;
pub use nets::*;
pub use shader::{Shader, constants, found};
pub use shared::{CAMERA, MATH, RNG};
pub use structs::*;

use shared::{
    EXPOSED, FAULTS, FILLING, FLAT, GRID, LEVEL_MARKS, LEVEL_SCALE, PART, QUANTA, SCATTERED, STEP, TARGET,
    WALK,
};

/// Returns the head of kernels that read rows of the tables: `Row` is one entry of `features` numbers, 2 or 4.
pub fn row_head(features: u32) -> String {
    format!("alias Row = vec{features}<f32>;\nconst FEATURES: u32 = {features}u;\n")
}

/// Returns the head of kernels that find entries: after [`row_head`], the hash's multipliers of y and z.
pub fn grid_head(features: u32, primes: [u32; 2]) -> String {
    let [y, z] = primes;
    format!(
        "{}const PRIME_Y: u32 = {y}u;\nconst PRIME_Z: u32 = {z}u;\n",
        row_head(features)
    )
}

/// Returns the head of kernels with gradients in fixed point, after one of those above. `Quanta` is the
/// gradient of an entry. `packed` means that pairs of features share a 64-bit word. No contribution has more
/// than `most` quanta.
pub fn quanta_head(features: u32, packed: bool, most: i32) -> String {
    format!(
        "alias Quanta = vec{features}<i32>;\nalias Sizes = vec{features}<u32>;\nconst PACKED: bool = {packed};\nconst MOST_QUANTA: i32 = {most};\n"
    )
}

/// Returns the head of kernels that go over all entries: `rows` entries a thread, 64 apart.
pub fn rows_head(rows: usize) -> String {
    format!("const ROWS: u32 = {rows}u;\n")
}

/// Stand-ins of the four heads, for the tests.
const TABLE_HEADS: &[&str] = &[
    "alias Row = vec2<f32>;\nconst FEATURES: u32 = 2u;\nconst PRIME_Y: u32 = 3u;\nconst PRIME_Z: u32 = 5u;\n\
     alias Quanta = vec2<i32>;\nalias Sizes = vec2<u32>;\nconst PACKED: bool = false;\nconst MOST_QUANTA: i32 = 99;\nconst ROWS: u32 = 8u;\n",
    "alias Row = vec4<f32>;\nconst FEATURES: u32 = 4u;\nconst PRIME_Y: u32 = 3u;\nconst PRIME_Z: u32 = 5u;\n\
     alias Quanta = vec4<i32>;\nalias Sizes = vec4<u32>;\nconst PACKED: bool = true;\nconst MOST_QUANTA: i32 = 99;\nconst ROWS: u32 = 4u;\n",
];

/// All kernels.
pub const SHADERS: &[Shader] = &[
    HASH_ENCODE,
    RAYS,
    VIEW_RAYS,
    MARCH,
    SCAN,
    ALIVE,
    EXPOSURE_SUMS,
    EXPOSURE_LEARN,
    SCATTER,
    SCATTER_PACKED,
    PEAK,
    RESCALE,
    ADAM_TABLE,
    PROBE,
    OCCUPANCY,
    DENSITY_SUM,
    THRESHOLDS,
    BITS,
    DENSITY,
    SHADE,
    BACK,
    SUM,
    ADAM_NET,
    OPACITY,
    KEPT,
    COMPARE,
    SPREAD,
    TOTALS,
    PAINT,
    FINISH,
    COPY,
    MULTIPLY_ADD,
];

/// Multiresolution hash-grid lookup, forward pass.
pub const HASH_ENCODE: Shader = Shader {
    name: "hash_encode",
    shared: &[FLAT, PART, GRID],
    text: include_str!("hash_encode.wgsl"),
    heads: TABLE_HEADS,
};

/// Gradients of features to gradients of entries, in fixed point.
pub const SCATTER: Shader = Shader {
    name: "scatter",
    shared: &[FLAT, PART, GRID, LEVEL_MARKS, SCATTERED],
    text: include_str!("scatter.wgsl"),
    heads: TABLE_HEADS,
};

/// As [`SCATTER`], two features in one 64-bit word.
pub const SCATTER_PACKED: Shader = Shader {
    name: "scatter_packed",
    shared: &[FLAT, PART, GRID, LEVEL_MARKS, SCATTERED],
    text: include_str!("scatter_packed.wgsl"),
    heads: TABLE_HEADS,
};

/// Largest quantum of every level.
pub const PEAK: Shader = Shader {
    name: "peak",
    shared: &[FLAT, PART, LEVEL_MARKS, QUANTA],
    text: include_str!("peak.wgsl"),
    heads: TABLE_HEADS,
};

/// Which levels overflowed, and the scales of the next step.
pub const RESCALE: Shader = Shader {
    name: "rescale",
    shared: &[LEVEL_SCALE, FAULTS],
    text: include_str!("rescale.wgsl"),
    heads: &[""],
};

/// One step of Adam over tables, and their running average.
pub const ADAM_TABLE: Shader = Shader {
    name: "adam_table",
    shared: &[FLAT, PART, LEVEL_SCALE, QUANTA, FAULTS],
    text: include_str!("adam_table.wgsl"),
    heads: TABLE_HEADS,
};

/// Cells of the occupancy grid to look at.
pub const PROBE: Shader = Shader {
    name: "probe",
    shared: &[FLAT, RNG],
    text: include_str!("probe.wgsl"),
    heads: &[""],
};

/// Densities found at the probes.
pub const OCCUPANCY: Shader = Shader {
    name: "occupancy",
    shared: &[FLAT, FILLING, MATH, FAULTS],
    text: include_str!("occupancy.wgsl"),
    heads: &["const RUNAWAY: u32 = 9u;\n"],
};

/// Partial sums of densities.
pub const DENSITY_SUM: Shader = Shader {
    name: "density_sum",
    shared: &[FILLING],
    text: include_str!("density_sum.wgsl"),
    heads: &["const EACH: u32 = 4u;\n"],
};

/// Densities from which on a cell is occupied.
pub const THRESHOLDS: Shader = Shader {
    name: "thresholds",
    shared: &[FILLING],
    text: include_str!("thresholds.wgsl"),
    heads: &[""],
};

/// Occupied cells from densities.
pub const BITS: Shader = Shader {
    name: "bits",
    shared: &[FLAT, FILLING, FAULTS],
    text: include_str!("bits.wgsl"),
    heads: &[""],
};

/// Draws the rays of a training step.
pub const RAYS: Shader = Shader {
    name: "rays",
    shared: &[FLAT, RNG, CAMERA, STEP, TARGET],
    text: include_str!("rays.wgsl"),
    heads: &[
        "const PURPOSE: u32 = 3u;\nconst NEWTON_STEPS: u32 = 20u;\nconst HIDDEN: u32 = 255u;\nconst DRAWS: u32 = 8u;\n",
    ],
};

/// Sets out the rays of some pixels of one photo.
pub const VIEW_RAYS: Shader = Shader {
    name: "view_rays",
    shared: &[FLAT, CAMERA],
    text: include_str!("view_rays.wgsl"),
    heads: &["const NEWTON_STEPS: u32 = 20u;\n"],
};

/// Walks along rays through occupied cells. Entries `count` and `write`.
pub const MARCH: Shader = Shader {
    name: "march",
    shared: &[FLAT, WALK],
    text: include_str!("march.wgsl"),
    heads: &["const LANES: u32 = 32u;\n"],
};

/// Where the samples of every ray begin.
pub const SCAN: Shader = Shader {
    name: "scan",
    shared: &[WALK],
    text: include_str!("scan.wgsl"),
    heads: &[""],
};

/// Finds which rays of a picture continue.
pub const ALIVE: Shader = Shader {
    name: "alive",
    shared: &[FLAT, WALK],
    text: include_str!("alive.wgsl"),
    heads: &["const OPAQUE: f32 = 0.1;\n"],
};

/// Adds up the slopes of exposures, photo by photo.
pub const EXPOSURE_SUMS: Shader = Shader {
    name: "exposure_sums",
    shared: &[EXPOSED, TARGET],
    text: include_str!("exposure_sums.wgsl"),
    heads: &["const RUNAWAY: u32 = 0x4e800000u;\n"],
};

/// Moves the exposures of all photos.
pub const EXPOSURE_LEARN: Shader = Shader {
    name: "exposure_learn",
    shared: &[STEP, EXPOSED, FAULTS],
    text: include_str!("exposure_learn.wgsl"),
    heads: &[""],
};

/// The ceiling of memory.
pub const COPY: Shader = Shader {
    name: "copy",
    shared: &[FLAT],
    text: include_str!("copy.wgsl"),
    heads: &[""],
};

/// The ceiling of arithmetic.
pub const MULTIPLY_ADD: Shader = Shader {
    name: "multiply_add",
    shared: &[FLAT],
    text: include_str!("multiply_add.wgsl"),
    heads: &[""],
};

#[cfg(test)]
mod guards;
#[cfg(test)]
mod tests;
