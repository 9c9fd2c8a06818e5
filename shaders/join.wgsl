// join: adds what compositing says of the raw density to what the colour network says of it.
//
// Source    the raw density is the first of the 16 outputs that the colour network reads.
// Twin      marf_field::batch::Scratch::backward; within 1e-6 of the larger of both: the CPU fuses d_tau * tau.
// Threads   one per sample: workgroup 64, folded.
// Reads     light row 0 of [3][capacity] (slope in the raw density, of `spread`), counts[slot] samples in use
// Writes    slope row 0 of [.][capacity], samples in use, each element once; its rows 1 to 15 are the slope of the other
//           outputs of the density network already
// Extremes  no sample: nothing is written.
@group(0) @binding(0) var<uniform> extent: Extent;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> light: array<f32>;
@group(0) @binding(3) var<storage, read_write> slope: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let sample = flat(id, groups);
    if sample >= counts[extent.slot] { return; }
    slope[sample] += light[sample];
}
