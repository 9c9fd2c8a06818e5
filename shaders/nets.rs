//! Texts and heads of the kernels of networks and of light along rays.

/// Sizes of columns.
pub(crate) const EXTENT: &str = include_str!("shared/extent.wgsl");
/// What changes from step to step.
pub(crate) const PACE: &str = include_str!("shared/pace.wgsl");

/// Colours of logits.
pub(crate) const COLOUR_OF: &str = include_str!("shared/colour.wgsl");
/// Spherical harmonics.
pub const HARMONICS_OF: &str = include_str!("shared/sh.wgsl");
/// The background by direction.
pub(crate) const BEHIND: &str = include_str!("shared/behind.wgsl");

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
pub(crate) const TILE: &str = include_str!("shared/tile.wgsl");
/// Kept samples in a tile.
pub(crate) const SEEN: &str = include_str!("shared/seen.wgsl");

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

/// Heads of kernels of networks.
pub(crate) const TILES: &[&str] = &[
    "const FOURS: u32 = 16u; const LAYERS: u32 = 6u; const DENSITY: u32 = 2u; const ROUNDS: u32 = 2u; const RUNAWAY: u32 = 9u; \
    const LOGIT_LIMIT: f32 = 1.0;",
    "const FOURS: u32 = 32u; const LAYERS: u32 = 4u; const DENSITY: u32 = 2u; const ROUNDS: u32 = 1u; const RUNAWAY: u32 = 9u; \
    const LOGIT_LIMIT: f32 = 1.0;",
];
/// Heads of the other kernels of light.
pub(crate) const HEADS: &[&str] = &[
    "const RUNAWAY: u32 = 9u; const APART: u32 = 4u; const RAW_LIMIT: f32 = 1.0; const RAW_SHIFT: f32 = -1.0; \
    const LOGIT_LIMIT: f32 = 1.0; const OPAQUE: f32 = 0.1; const EVEN: f32 = 0.1;",
];
