// transpose: weights of a layer for its backward pass.
//
// Source    none.
// Twin      marf_field::cpu::net::Layer::refresh; equal to the bit.
// Threads   one per weight: workgroup 64, folded.
// Reads     weights [inputs][outputs]
// Writes    turned [outputs][inputs], each element once
// Extremes  every number is copied, NaN too (a driver may change its bits).
struct TransposeRun {
    inputs: u32,
    outputs: u32,
}
@group(0) @binding(0) var<uniform> run: TransposeRun;
@group(0) @binding(1) var<storage, read> weights: array<f32>;
@group(0) @binding(2) var<storage, read_write> turned: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let index = flat(id, groups);
    if index >= run.inputs * run.outputs { return; }
    let input = index / run.outputs;
    let output = index % run.outputs;
    turned[output * run.inputs + input] = weights[index];
}
