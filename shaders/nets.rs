//! The kernels of networks and of light along rays.

use crate::shader::Shader;
use crate::shared::{FAULTS, FLAT, MATH, TARGET};

/// Sizes of columns.
const EXTENT: &str = include_str!("shared/extent.wgsl");
/// What changes from step to step.
const PACE: &str = include_str!("shared/pace.wgsl");

/// Colours of logits.
const COLOUR_OF: &str = include_str!("shared/colour.wgsl");
/// Spherical harmonics.
pub const HARMONICS_OF: &str = include_str!("shared/sh.wgsl");
/// The background by direction.
const BEHIND: &str = include_str!("shared/behind.wgsl");

/// The limits of the numbers of a field, as the CPU has them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Numbers of this size count as not finite.
    pub runaway: f32,
    /// Raw densities are cut here.
    pub raw: f32,
    /// Added to a raw density before the exponential.
    pub shift: f32,
    /// Logits of colours are cut at plus and minus this.
    pub logit: f32,
    /// Samples behind a lesser transmittance are left out.
    pub opaque: f32,
    /// Part of the samples chosen on a ray that is spread evenly.
    pub even: f32,
}

/// One in this many adjacent threads walks along a ray. Rays that share a wave wait for each other's reads,
/// and a card has more waves than a batch has rays.
pub const APART: usize = 4;

impl Limits {
    /// Returns the head of kernels that look at these numbers.
    pub fn head(&self) -> String {
        let bits = self.runaway.to_bits();
        let mut head = format!("const RUNAWAY: u32 = {bits}u;\nconst APART: u32 = {APART}u;\n");
        for (name, value) in [
            ("RAW_LIMIT", self.raw),
            ("RAW_SHIFT", self.shift),
            ("LOGIT_LIMIT", self.logit),
            ("OPAQUE", self.opaque),
            ("EVEN", self.even),
        ] {
            head += &format!("const {name}: f32 = {value:?};\n");
        }
        head
    }
}

/// A tile of samples.
const TILE: &str = include_str!("shared/tile.wgsl");
/// Kept samples in a tile.
const SEEN: &str = include_str!("shared/seen.wgsl");

/// Numbers of the tile of samples that a workgroup of the networks has in its memory: 16 KB, which core WebGPU grants.
pub const TILE_NUMBERS: usize = 4096;

/// Returns the head of kernels of networks: `fours` groups of 4 samples make a tile. Of the `layers` layers,
/// [`MOST_LAYERS`] at most, the first `density`, two at most, are those of the density network.
pub fn tile_head(fours: usize, layers: usize, density: usize) -> String {
    format!(
        "const FOURS: u32 = {fours}u;\nconst LAYERS: u32 = {layers}u;\nconst DENSITY: u32 = {density}u;\n"
    )
}

/// Returns the additional head of `back`: a workgroup takes at most `rounds` tiles.
pub fn rounds_head(rounds: usize) -> String {
    format!("const ROUNDS: u32 = {rounds}u;\n")
}

const PLAIN: &[&str] = &[""];
/// Heads of kernels of networks.
const TILES: &[&str] = &[
    "const FOURS: u32 = 16u; const LAYERS: u32 = 6u; const DENSITY: u32 = 2u; const ROUNDS: u32 = 2u; const RUNAWAY: u32 = 9u; \
    const LOGIT_LIMIT: f32 = 1.0;",
    "const FOURS: u32 = 32u; const LAYERS: u32 = 4u; const DENSITY: u32 = 2u; const ROUNDS: u32 = 1u; const RUNAWAY: u32 = 9u; \
    const LOGIT_LIMIT: f32 = 1.0;",
];
const HEADS: &[&str] = &[
    "const RUNAWAY: u32 = 9u; const APART: u32 = 4u; const RAW_LIMIT: f32 = 1.0; const RAW_SHIFT: f32 = -1.0; \
    const LOGIT_LIMIT: f32 = 1.0; const OPAQUE: f32 = 0.1; const EVEN: f32 = 0.1;",
];

/// The density network over visited samples.
pub const DENSITY: Shader = Shader {
    name: "density",
    shared: &[TILE],
    text: include_str!("density.wgsl"),
    heads: TILES,
};

/// The colour network over kept samples, and their colours.
pub const SHADE: Shader = Shader {
    name: "shade",
    shared: &[MATH, COLOUR_OF, HARMONICS_OF, TILE, SEEN],
    text: include_str!("shade.wgsl"),
    heads: TILES,
};

/// Both networks back over kept samples.
pub const BACK: Shader = Shader {
    name: "back",
    shared: &[MATH, HARMONICS_OF, TILE, SEEN],
    text: include_str!("back.wgsl"),
    heads: TILES,
};

/// Adds the parts of a gradient.
pub const SUM: Shader = Shader {
    name: "sum",
    shared: &[MATH],
    text: include_str!("sum.wgsl"),
    heads: HEADS,
};

/// Adam in rows of 16 numbers.
pub const ADAM_NET: Shader = Shader {
    name: "adam_net",
    shared: &[FLAT, PACE, FAULTS],
    text: include_str!("adam_net.wgsl"),
    heads: PLAIN,
};

/// Raw densities to opacities and transmittances along rays.
pub const OPACITY: Shader = Shader {
    name: "opacity",
    shared: &[FLAT, EXTENT, MATH],
    text: include_str!("opacity.wgsl"),
    heads: HEADS,
};

/// Which of the visited samples the kept ones are.
pub const KEPT: Shader = Shader {
    name: "kept",
    shared: &[FLAT, EXTENT],
    text: include_str!("kept.wgsl"),
    heads: &["const LANES: u32 = 32u;\n"],
};

/// Compares the colour of a ray with its pixel.
pub const COMPARE: Shader = Shader {
    name: "compare",
    shared: &[FLAT, MATH, COLOUR_OF, HARMONICS_OF, BEHIND, TARGET],
    text: include_str!("compare.wgsl"),
    heads: HEADS,
};

/// Slope of a ray's colour to those of its samples.
pub const SPREAD: Shader = Shader {
    name: "spread",
    shared: &[FLAT, MATH, COLOUR_OF],
    text: include_str!("spread.wgsl"),
    heads: HEADS,
};

/// Counts and loss of a step for the host.
pub const TOTALS: Shader = Shader {
    name: "totals",
    shared: &[EXTENT, PACE],
    text: include_str!("totals.wgsl"),
    heads: PLAIN,
};

/// Takes the samples of a round into the rays of a picture. Entries `begin` and `main`.
pub const PAINT: Shader = Shader {
    name: "paint",
    shared: &[FLAT],
    text: include_str!("paint.wgsl"),
    heads: HEADS,
};

/// Rays of a picture to its pixels.
pub const FINISH: Shader = Shader {
    name: "finish",
    shared: &[FLAT, MATH, COLOUR_OF, HARMONICS_OF, BEHIND],
    text: include_str!("finish.wgsl"),
    heads: HEADS,
};
