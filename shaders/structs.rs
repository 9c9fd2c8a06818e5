//! The uniforms and elements of arrays that kernels read, as Rust writes them.

/// Places in the array `counts`, which most kernels read: how many samples and rays are in use.
pub mod counts {
    /// Samples that rays visited.
    pub const VISITED: u32 = 0;
    /// Samples that are trained: no others show.
    pub const KEPT: u32 = 1;
    /// Rays whose samples fit.
    pub const RAYS: u32 = 2;
    /// Rays that continue.
    pub const ALIVE: u32 = 3;
    /// Numbers.
    pub const LEN: usize = 4;
}

/// Places in the array `faults`: what ran away.
pub mod faults {
    /// A raw density.
    pub const DENSITY: u32 = 0;
    /// A logit of a colour.
    pub const LOGITS: u32 = 1;
    /// A loss.
    pub const LOSS: u32 = 2;
    /// A slope of the features.
    pub const FEATURES: u32 = 3;
    /// A gradient of a network.
    pub const NETWORKS: u32 = 4;
    /// The background or its gradient.
    pub const BACKGROUND: u32 = 5;
    /// A slope of an exposure, or an exposure.
    pub const EXPOSURES: u32 = 6;
    /// Numbers.
    pub const LEN: usize = 8;
}

uniforms! {
    /// One level of the grid, an element of `levels`.
    pub struct GridLevel {
        /// Cells a side.
        pub resolution: u32,
        /// Entries of its table. A power of two where hashed.
        pub entries: u32,
        /// Its first entry in the table of all levels.
        pub first: u32,
        /// 1 where every corner has its own entry, 0 where corners are hashed.
        pub dense: u32,
    }

    /// What changes with every step of training.
    pub struct Step {
        /// The seed, low half first.
        pub seed: [u32; 2],
        /// Optimiser steps taken, low half first.
        pub number: [u32; 2],
        /// Kept pixels of all photos.
        pub pixels: u32,
        /// Pixels with a sparse point, a distance or sky. 0 where none pulls, or no longer.
        pub observations: u32,
        /// One ray in this many goes to an observation.
        pub share: u32,
        /// Rays wanted.
        pub rays: u32,
        /// Photos.
        pub views: u32,
        /// Weight of a pull.
        pub pull: f32,
        /// Step size of the optimiser.
        pub rate: f32,
        /// Padding to 16 bytes.
        pub pad: u32,
    }

    /// A camera with its pose, an element of `cameras`.
    pub struct ViewCamera {
        /// fx, fy, cx, cy, pixels.
        pub lens: [f32; 4],
        /// k1, k2, p1, p2.
        pub distortion: [f32; 4],
        /// First row of the rotation from the camera to the world. The fourth number is the centre, half sides.
        pub row_x: [f32; 4],
        /// Second row, in the same way.
        pub row_y: [f32; 4],
        /// Third row, in the same way.
        pub row_z: [f32; 4],
        /// Number of its first kept pixel among all.
        pub first: u32,
        /// Pixels of a run. One of them is kept.
        pub run: u32,
        /// Pixels a row of the photo.
        pub width: u32,
        /// Rows of the photo.
        pub height: u32,
        /// Number of the opacity of its first kept pixel among all, and 1. 0: it is opaque.
        pub alpha: u32,
        /// Padding to 16 bytes.
        pub pad: [u32; 3],
    }

    /// A pixel that sees a sparse point or has a distance, an element of `observations`.
    pub struct Observed {
        /// Number of the pixel among all kept.
        pub pixel: u32,
        /// Number of the step at the point as a share of all steps.
        pub place: f32,
        /// Share of the weight of a pull. 0 beyond the steps.
        pub share: f32,
    }

    /// What a ray is compared with, an element of `targets`.
    pub struct Target {
        /// The pixel, sRGB in [0, 1] over black.
        pub rgb: [f32; 3],
        /// Number of the view.
        pub view: u32,
        /// sRGB that is put behind the last sample, in [0, 1).
        pub behind: [f32; 3],
        /// How much of it the pixel shows, in [0, 1]. Below 0 the background is behind.
        pub share: f32,
    }

    /// Pixels of one photo whose rays are wanted.
    pub struct PixelRange {
        /// The camera. `first` and `run` are not read.
        pub camera: ViewCamera,
        /// First pixel, counted along the rows.
        pub first: u32,
        /// Pixels.
        pub count: u32,
        /// Place of samples within every step, in [0, 1).
        pub jitter: f32,
        /// Padding to 16 bytes.
        pub pad: u32,
    }

    /// Sizes and limits of a walk along rays.
    pub struct Walk {
        /// Rays in use.
        pub rays: u32,
        /// Slots there are for rays.
        pub ray_slots: u32,
        /// Slots there are for samples.
        pub capacity: u32,
        /// A ray pauses after the block of 16 steps in which it reaches this many samples, at least 1.
        pub limit: u32,
        /// Steps along a ray.
        pub steps: u32,
        /// Steps with those that fill up the last block of 16.
        pub padded: u32,
        /// Cells a side of the occupancy grid.
        pub side: u32,
        /// 1 where rays continue from where they were, 0 where they begin at the first step.
        pub resumes: u32,
        /// Place in `counts` of the number of samples.
        pub slot: u32,
        /// 1 where `counts` already has which rays are in use.
        pub again: u32,
    }

    /// Sizes and rates of the kernels of exposures.
    pub struct Exposed {
        /// Photos.
        pub views: u32,
        /// 1 where photos have offsets behind their gains.
        pub offsets: u32,
        /// Slots there are for rays.
        pub ray_slots: u32,
        /// Step size as a share of that of the other weights.
        pub share: f32,
        /// Gains and offsets stay within +- these.
        pub limits: [f32; 2],
        /// Decay of both moments.
        pub decays: [f32; 2],
        /// Added to the root of the second moment.
        pub epsilon: f32,
        /// First row of the slopes in their array: three of gains, three of offsets.
        pub row: u32,
    }

    /// What one dispatch over the grid works on: some levels whose tables fit one binding.
    pub struct GridPart {
        /// Samples of a column.
        pub capacity: u32,
        /// Place of the number of samples in `counts`.
        pub slot: u32,
        /// The first level. The workgroup's z counts from it.
        pub level: u32,
        /// The first entry that is bound.
        pub base: u32,
    }

    /// One level's fixed point, an element of `scales`.
    pub struct LevelScale {
        /// Quanta a unit of gradient, a power of two, for what is added next.
        pub scale: f32,
        /// 1 / scale of what was added last.
        pub quantum: f32,
        /// Largest |q| of its entries. 0 between steps.
        pub peak: u32,
        /// 1 where a single contribution was clamped. 0 between steps.
        pub clamped: u32,
        /// 1 where the last step left the level as it was.
        pub skip: u32,
        /// Steps that were left out so far.
        pub overflows: u32,
        /// First entry in the table of all levels.
        pub first: u32,
        /// Entries.
        pub entries: u32,
    }

    /// How scales follow the gradients.
    pub struct Rescaling {
        /// Levels.
        pub levels: u32,
        /// log2 of the peak that is aimed at.
        pub target_bits: i32,
        /// Largest peak that counts.
        pub most: u32,
        /// log2 of what a scale falls by after an overflow.
        pub back_off: i32,
        /// log2 of the smallest scale.
        pub lowest: i32,
        /// log2 of the largest scale.
        pub highest: i32,
        /// log2 of what a scale rises by at most.
        pub rise: i32,
        /// Padding to 16 bytes.
        pub pad: u32,
    }

    /// Rates of one step of Adam.
    pub struct Rates {
        /// Step size.
        pub rate: f32,
        /// Added to the root of the second moment.
        pub epsilon: f32,
        /// Pulls weights to zero: this times the weight is added to its gradient.
        pub decay: f32,
        /// Decay of the first moment.
        pub beta1: f32,
        /// Decay of the second moment.
        pub beta2: f32,
        /// Share of itself that the running average keeps.
        pub keep: f32,
        /// Padding to 16 bytes.
        pub pad: [f32; 2],
    }

    /// Which cells of the occupancy grid a pass looks at.
    pub struct Probing {
        /// Seed, lower half first.
        pub seed: [u32; 2],
        /// Number of the update, lower half first.
        pub round: [u32; 2],
        /// Purpose of the random numbers.
        pub purpose: u32,
        /// Slots of a pass.
        pub capacity: u32,
        /// The pass' first candidate.
        pub first: u32,
        /// Cells a side.
        pub side: u32,
        /// Candidate j is cell `every` j + `offset`.
        pub every: u32,
        /// See `every`.
        pub offset: u32,
        /// One in this many empty cells, a multiple of `every`: where `factor` cell + `phase` is a multiple of
        /// it.
        pub empty: u32,
        /// See `empty`.
        pub factor: u32,
        /// See `empty`.
        pub phase: u32,
        /// Place in `counts` of the number of probes.
        pub slot: u32,
        /// Padding to 16 bytes.
        pub pad: [u32; 2],
    }

    /// How densities become occupied cells.
    pub struct Filling {
        /// Cells of the grid.
        pub cells: u32,
        /// Partial sums.
        pub parts: u32,
        /// Slots of a pass of probes.
        pub capacity: u32,
        /// 1 where empty cells fill at the density of occupied ones, 0 where it shows by itself.
        pub at_mean: u32,
        /// Share of a density that remains when its cell is probed again.
        pub decay: f32,
        /// Density of a cell that has not been looked at.
        pub unknown: f32,
        /// Density that shows in a step of the shortest length.
        pub shows: f32,
        /// Added to the raw density before the exponential.
        pub shift: f32,
        /// Place in `counts` of the number of probes.
        pub slot: u32,
    }

    /// Sum and number of some densities.
    pub struct Tally {
        /// Sum.
        pub sum: f32,
        /// Number.
        pub count: u32,
    }
}
