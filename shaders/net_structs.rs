//! The uniforms of the kernels of networks and of light, and what they report to the host.

use bytemuck::{Pod, Zeroable};

/// Sizes of a layer and where its columns are.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
pub struct ProductRun {
    /// Neurons that go in.
    pub inner: u32,
    /// Neurons that come out.
    pub outputs: u32,
    /// Numbers a column.
    pub capacity: u32,
    /// Place in `counts` of the samples in use.
    pub slot: u32,
    /// First row of A.
    pub first_a: u32,
    /// First row of C.
    pub first_c: u32,
    /// Padding to 16 bytes.
    pub pad: [u32; 2],
}

/// Sizes of a layer.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
pub struct TransposeRun {
    /// Rows.
    pub inputs: u32,
    /// Columns.
    pub outputs: u32,
}

/// Sizes of a layer, where its columns are and how they are cut.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
pub struct OuterRun {
    /// Neurons that go in, a multiple of 4.
    pub inner: u32,
    /// Neurons that come out, a multiple of 8.
    pub outputs: u32,
    /// Numbers a column.
    pub capacity: u32,
    /// Place in `counts` of the samples in use.
    pub slot: u32,
    /// Samples a part, a multiple of 4.
    pub chunk: u32,
    /// First row of A.
    pub first_a: u32,
    /// First row of D.
    pub first_d: u32,
    /// Padding to 16 bytes.
    pub pad: u32,
}

/// Which parts are summed, and the fault to set where a sum runs away.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
pub struct SumRun {
    /// Numbers a part.
    pub weights: u32,
    /// Place in `counts` of the samples in use.
    pub slot: u32,
    /// Samples a part.
    pub chunk: u32,
    /// Place in `faults`.
    pub fault: u32,
}

/// Adam's numbers for one tensor.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
pub struct AdamNet {
    /// Rows of 16 numbers.
    pub rows: u32,
    /// Last place of the table of corrections.
    pub last: u32,
    /// Step size in learning rates.
    pub factor: f32,
    /// Pull to zero.
    pub decay: f32,
    /// Added to the root.
    pub epsilon: f32,
    /// Decay of the first moment.
    pub beta1: f32,
    /// Decay of the second moment.
    pub beta2: f32,
    /// Padding to 16 bytes.
    pub pad: u32,
}

/// What changes from step to step.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
pub struct Pace {
    /// Learning rate.
    pub rate: f32,
    /// Place in the ring of totals.
    pub total: u32,
    /// Padding to 16 bytes.
    pub pad: [u32; 2],
}

/// Which rows harmonics are written to.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
pub struct HarmonicsRun {
    /// Place in `counts` of what is in use.
    pub slot: u32,
    /// Numbers a column.
    pub stride: u32,
    /// First row.
    pub first: u32,
    /// Padding to 16 bytes.
    pub pad: u32,
}

/// Sizes of columns.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
pub struct Extent {
    /// Place in `counts` of what is in use.
    pub slot: u32,
    /// Numbers a column of samples.
    pub capacity: u32,
    /// Numbers a column of rays.
    pub rays: u32,
    /// Padding to 16 bytes.
    pub pad: u32,
}

/// Which rows are copied.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
pub struct GatherRun {
    /// Place in `counts` of the samples in use.
    pub slot: u32,
    /// Numbers a column.
    pub capacity: u32,
    /// First row of the source.
    pub first_from: u32,
    /// First row of what it is copied to.
    pub first_to: u32,
}

/// Sizes and switches of the comparison of rays with pixels.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
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
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
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

/// Which rows are checked, and the fault to set where a number runs away.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
pub struct RunawayRun {
    /// Place in `counts` of the samples in use.
    pub slot: u32,
    /// Numbers a column.
    pub capacity: u32,
    /// Place in `faults`.
    pub fault: u32,
    /// Padding to 16 bytes.
    pub pad: u32,
}

/// Counts and loss of a step, read by the host.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
pub struct Total {
    /// Samples that rays visited.
    pub visited: u32,
    /// Samples that were trained.
    pub kept: u32,
    /// Rays in use.
    pub rays: u32,
    /// Rays that go on.
    pub alive: u32,
    /// One bit for each of `faults`.
    pub faults: u32,
    /// Sum of squared errors over rays and channels.
    pub loss: f32,
    /// Padding to 16 bytes.
    pub pad: [u32; 2],
}

/// Sizes, and the optical depth at which rays end.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
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
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
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
