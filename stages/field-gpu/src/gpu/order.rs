//! What decides the order of sums on a device, and so their bits: a part of the backend id.

/// Workgroups among which the tiles of the way back are dealt out, at most: six for each of the 132 cores of the largest cards.
/// The same on every device, so that sums have one order.
pub const GROUPS: usize = 792;
/// Numbers of all workgroups on the way back, at most, 120 MiB: a binding of core WebGPU holds 128, with the background's parts.
pub const MOST_WORK: usize = 30 << 20;
/// Slots of samples and rays at once: the first whose samples a card can bind. A round of few samples is
/// mostly gaps between dispatches and kernels along rays (`benches/gpu.md`). Devices that share the memory
/// and software have the fewest.
pub const AT_ONCE: [[usize; 2]; 3] = [[1 << 20, 1 << 16], [1 << 18, 1 << 15], [1 << 17, 1 << 14]];
/// Samples that a ray gets in the first round. Later rounds take twice as many.
pub const FIRST_ROUND: u32 = 8;
