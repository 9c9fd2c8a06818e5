//! The uniforms of the kernels of networks and of light, and what they report to the host.

/// Layers that a field has at most: two of the density network, four of the colour network.
pub const MOST_LAYERS: usize = 6;

uniforms! {
    /// All layers: the density network's, then the colour network's.
    pub struct NetsRun {
        /// Numbers a column of samples.
        pub capacity: u32,
        /// Weights of both.
        pub weights: u32,
        /// 1 where the colour network sees the direction.
        pub directed: u32,
        /// Numbers of a workgroup in `work`.
        pub stride: u32,
        /// Workgroups among which the tiles are dealt out.
        pub groups: u32,
        /// Outputs of the density network that are read, a multiple of 8.
        pub latents: u32,
        /// Padding to 16 bytes.
        pub pad: [u32; 2],
        /// Of every layer: inputs, outputs, first weight, first row of its input in the workgroup's own memory.
        pub shapes: [[u32; 4]; MOST_LAYERS],
    }

    /// Which parts are summed.
    pub struct SumRun {
        /// Weights of the networks.
        pub weights: u32,
        /// Numbers of a group.
        pub stride: u32,
        /// Groups of samples.
        pub groups: u32,
        /// Samples of a tile.
        pub samples: u32,
        /// First number of the background's parts.
        pub first: u32,
        /// 1 where the background is learnt.
        pub behind: u32,
        /// Padding to 16 bytes.
        pub pad: [u32; 2],
    }

    /// Adam's numbers for networks and background.
    pub struct AdamNet {
        /// Rows of 16 numbers.
        pub rows: u32,
        /// Last place of the table of corrections.
        pub last: u32,
        /// First row of the background, which has a step size of its own and no pull to zero.
        pub behind: u32,
        /// Step size of the background in learning rates.
        pub factor: f32,
        /// Pull to zero of the networks.
        pub decay: f32,
        /// Added to the root.
        pub epsilon: f32,
        /// Decay of the first moment.
        pub beta1: f32,
        /// Decay of the second moment.
        pub beta2: f32,
    }

    /// What changes from step to step.
    pub struct Pace {
        /// Learning rate.
        pub rate: f32,
        /// Place in the ring of totals.
        pub total: u32,
        /// Share of themselves that the averages of the networks keep. 1 where they stay.
        pub keep: f32,
        /// Padding to 16 bytes.
        pub pad: u32,
    }

    /// Sizes of columns.
    pub struct Extent {
        /// Place in `counts` of what is in use.
        pub slot: u32,
        /// Numbers a column of samples.
        pub capacity: u32,
        /// Numbers a column of rays.
        pub rays: u32,
        /// Samples of a ray that are kept, about. 0: all that show.
        pub most: u32,
    }

    /// Sizes and switches of the comparison of rays with pixels.
    pub struct CompareRun {
        /// Place in `counts` of the rays in use.
        pub slot: u32,
        /// Numbers a column of samples.
        pub capacity: u32,
        /// Numbers a column of rays.
        pub rays: u32,
        /// Photos.
        pub views: u32,
        /// 1 where photos have offsets.
        pub offsets: u32,
        /// 1 where the background is learnt, 0 where it is black.
        pub behind: u32,
        /// Padding to 16 bytes.
        pub pad: [u32; 2],
    }

    /// Sizes and weights of the losses.
    pub struct SpreadRun {
        /// Place in `counts` of the rays in use.
        pub slot: u32,
        /// Numbers a column of samples.
        pub capacity: u32,
        /// Numbers a column of rays.
        pub rays: u32,
        /// Weight of the distortion loss.
        pub distortion: f32,
        /// Length of a step in units of place.
        pub cell: f32,
        /// Price of opacity.
        pub emptiness: f32,
        /// Steps around a point that count as near.
        pub reach: f32,
        /// Added to the weight near a point.
        pub floor: f32,
    }

    /// Counts and loss of a step, read by the host.
    pub struct Total {
        /// Samples that rays visited.
        pub visited: u32,
        /// Samples that were trained.
        pub kept: u32,
        /// Rays in use.
        pub rays: u32,
        /// Rays that continue.
        pub alive: u32,
        /// One bit for each of `faults`.
        pub faults: u32,
        /// Sum of squared errors over rays and channels.
        pub loss: f32,
        /// Padding to 16 bytes.
        pub pad: [u32; 2],
    }

    /// Sizes, and the optical depth at which rays end.
    pub struct PaintRun {
        /// Place in `counts` of the rays in use.
        pub slot: u32,
        /// Numbers a column of samples.
        pub capacity: u32,
        /// Numbers a column of rays.
        pub rays: u32,
        /// Optical depth that ends a ray.
        pub deep: f32,
    }

    /// Sizes of a picture and its background.
    pub struct FinishRun {
        /// Place in `counts` of the rays in use.
        pub slot: u32,
        /// Numbers a column of rays.
        pub rays: u32,
        /// 1 where the background is learnt, 0 where it is black.
        pub behind: u32,
        /// Half side of the box, world units.
        pub half_side: f32,
    }
}
