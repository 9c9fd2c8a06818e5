// blend: running average of weights.
//
// Source    none: average += (1 - keep) (value - average).
// Twin      marf_field::learn::blend; equal within one rounding of the larger: a GPU may contract the sum.
// Threads   one per 4 numbers: workgroup 64, folded over x and y.
// Reads     values [n / 4] of vec4, faults [FAULT_SLOTS]
// Writes    average [n / 4] of vec4, each element exactly once; nothing where a fault is set
// Extremes  keep 1 leaves the average, keep 0 takes the values but for a rounding.
struct Blending {
    keep: f32,
    pad0: f32,
    pad1: f32,
    pad2: f32,
}
@group(0) @binding(0) var<uniform> blending: Blending;
@group(0) @binding(1) var<storage, read> faults: array<vec4<u32>, FAULT_SLOTS / 4u>;
@group(0) @binding(2) var<storage, read> values: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> average: array<vec4<f32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let at = flat(id, groups);
    if at >= arrayLength(&average) || faulted() {
        return;
    }
    average[at] += (1.0 - blending.keep) * (values[at] - average[at]);
}
