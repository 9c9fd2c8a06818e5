//! WGSL kernels of marf and their uniforms. One kernel a file, each with its contract at the head.
//!
//! Invariants: every kernel parses and validates in naga, with no capability beyond core WebGPU unless its
//! contract says so. No place, size or rate is written in both Rust and WGSL. Rust writes it into
//! [`constants`], the head or a uniform, and a test compares every field of every uniform by name, type and
//! offset.

/// Lays structs out as WGSL reads them.
macro_rules! uniforms {
    ($($item:item)*) => {$(
        #[repr(C)]
        #[derive(Debug, Clone, Copy, PartialEq, Default, bytemuck::Pod, bytemuck::Zeroable)]
        $item
    )*};
}

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

/// Declares the kernels, each with the file of its name: the texts it shares with others, and the heads it is tested with.
macro_rules! shaders {
    ($($(#[$about:meta])* $constant:ident: $name:literal, [$($shared:ident),*], $heads:expr;)*) => {
        $($(#[$about])*
        pub const $constant: Shader = Shader {
            name: $name,
            shared: &[$($shared),*],
            text: include_str!(concat!($name, ".wgsl")),
            heads: $heads,
        };)*

        /// All kernels.
        pub const SHADERS: &[Shader] = &[$($constant),*];
    };
}

shaders! {
    /// Multiresolution hash-grid lookup, forward pass.
    HASH_ENCODE: "hash_encode", [FLAT, PART, GRID], TABLE_HEADS;
    /// Draws the rays of a training step.
    RAYS: "rays", [FLAT, RNG, CAMERA, STEP, TARGET],
        &["const PURPOSE: u32 = 3u;\nconst NEWTON_STEPS: u32 = 20u;\nconst HIDDEN: u32 = 255u;\nconst DRAWS: u32 = 8u;\n"];
    /// Sets out the rays of some pixels of one photo.
    VIEW_RAYS: "view_rays", [FLAT, CAMERA], &["const NEWTON_STEPS: u32 = 20u;\n"];
    /// Walks along rays through occupied cells. Entries `count` and `write`.
    MARCH: "march", [FLAT, WALK], &["const LANES: u32 = 32u;\n"];
    /// Where the samples of every ray begin.
    SCAN: "scan", [WALK], &[""];
    /// Finds which rays of a picture continue.
    ALIVE: "alive", [FLAT, WALK], &["const OPAQUE: f32 = 0.1;\n"];
    /// Adds up the slopes of exposures, photo by photo.
    EXPOSURE_SUMS: "exposure_sums", [EXPOSED, TARGET], &["const RUNAWAY: u32 = 0x4e800000u;\n"];
    /// Moves the exposures of all photos.
    EXPOSURE_LEARN: "exposure_learn", [STEP, EXPOSED, FAULTS], &[""];
    /// Gradients of features to gradients of entries, in fixed point.
    SCATTER: "scatter", [FLAT, PART, GRID, LEVEL_MARKS, SCATTERED], TABLE_HEADS;
    /// As [`SCATTER`], two features in one 64-bit word.
    SCATTER_PACKED: "scatter_packed", [FLAT, PART, GRID, LEVEL_MARKS, SCATTERED], TABLE_HEADS;
    /// Largest quantum of every level.
    PEAK: "peak", [FLAT, PART, LEVEL_MARKS, QUANTA], TABLE_HEADS;
    /// Which levels overflowed, and the scales of the next step.
    RESCALE: "rescale", [LEVEL_SCALE, FAULTS], &[""];
    /// One step of Adam over tables, and their running average.
    ADAM_TABLE: "adam_table", [FLAT, PART, LEVEL_SCALE, QUANTA, FAULTS], TABLE_HEADS;
    /// Cells of the occupancy grid to look at.
    PROBE: "probe", [FLAT, RNG], &[""];
    /// Densities found at the probes.
    OCCUPANCY: "occupancy", [FLAT, FILLING, MATH, FAULTS], &["const RUNAWAY: u32 = 9u;\n"];
    /// Partial sums of densities.
    DENSITY_SUM: "density_sum", [FILLING], &["const EACH: u32 = 4u;\n"];
    /// Densities from which on a cell is occupied.
    THRESHOLDS: "thresholds", [FILLING], &[""];
    /// Occupied cells from densities.
    BITS: "bits", [FLAT, FILLING, FAULTS], &[""];
    /// The density network over visited samples.
    DENSITY: "density", [TILE], TILES;
    /// The colour network over kept samples, and their colours.
    SHADE: "shade", [MATH, COLOUR_OF, HARMONICS_OF, TILE, SEEN], TILES;
    /// Both networks back over kept samples.
    BACK: "back", [MATH, HARMONICS_OF, TILE, SEEN], TILES;
    /// Adds the parts of a gradient.
    SUM: "sum", [MATH], HEADS;
    /// Adam in rows of 16 numbers.
    ADAM_NET: "adam_net", [FLAT, PACE, FAULTS], &[""];
    /// Raw densities to opacities and transmittances along rays.
    OPACITY: "opacity", [FLAT, EXTENT, MATH], HEADS;
    /// Which of the visited samples the kept ones are.
    KEPT: "kept", [FLAT, EXTENT], &["const LANES: u32 = 32u;\n"];
    /// Compares the colour of a ray with its pixel.
    COMPARE: "compare", [FLAT, MATH, COLOUR_OF, HARMONICS_OF, BEHIND, TARGET], HEADS;
    /// Slope of a ray's colour to those of its samples.
    SPREAD: "spread", [FLAT, MATH, COLOUR_OF], HEADS;
    /// Counts and loss of a step for the host.
    TOTALS: "totals", [EXTENT, PACE], &[""];
    /// Takes the samples of a round into the rays of a picture. Entries `begin` and `main`.
    PAINT: "paint", [FLAT], HEADS;
    /// Rays of a picture to its pixels.
    FINISH: "finish", [FLAT, MATH, COLOUR_OF, HARMONICS_OF, BEHIND], HEADS;
}

#[cfg(test)]
mod guards;
#[cfg(test)]
mod tests;
