// density: the density network over visited samples.
//
// Source    instant-ngp, arXiv 2201.05989, section 4; ReLU between the layers, no biases.
// Twin      marf_field::cpu::net::Net::forward; the same chain of fused multiply-adds in the order of inputs. Equal to the
//           bit where fma is fused, else within 1e-6 of the sum of the sizes of the terms.
// Threads   one workgroup of 64 a tile of 4 FOURS samples, folded over x and y.
// Reads     features [inputs][capacity], weights, counts[COUNT_VISITED] samples in use
// Writes    latent [16][capacity] of tiles that hold samples, each element once
// Extremes  NaN passes through a ReLU. What lies beyond the samples in use is never mixed with others. No sample: nothing
//           is written.
@group(0) @binding(0) var<uniform> run: NetsRun;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> features: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> weights: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> latent: array<vec4<f32>>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) me: u32,
) {
    let first = (group.x + group.y * groups.x) * FOURS;
    let column = run.capacity / 4u;
    if 4u * first >= min(counts[COUNT_VISITED], run.capacity) { return; }
    for (var at = me; at < run.shapes[0].x * FOURS; at += THREADS) {
        tile[at] = features[at / FOURS * column + first + at % FOURS];
    }
    workgroupBarrier();
    for (var layer = 0u; layer < run.density; layer++) { advance(run.shapes[layer], me, layer + 1u < run.density); }
    for (var at = me; at < 16u * FOURS; at += THREADS) {
        latent[at / FOURS * column + first + at % FOURS] = tile[at];
    }
}
