// density: the density network over visited samples.
//
// Source    instant-ngp, arXiv 2201.05989, section 4. ReLU between the layers, no biases.
// Twin      marf_field::cpu::net::Net::forward, the same chain of fused multiply-adds in the order of inputs. Equal to
//           the bit where fma is fused, else within 1e-6 of the sum of the sizes of the terms.
// Threads   one workgroup of 64 a tile of 4 FOURS samples, folded over x and y.
// Reads     `features` [inputs][capacity], `weights`, `counts`[COUNT_VISITED] samples in use.
// Writes    `latent` [16][capacity] of tiles that hold samples, each element once: only run.latents rows, 8 or 16.
// Extremes  NaN passes through a ReLU. Samples beyond those in use are never mixed with others. No sample: nothing is
//           written.
@group(0) @binding(0) var<uniform> run: NetsRun;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> features: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> weights: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> latent: array<vec4<f32>>;

// Stores outputs 8 eight .. 8 eight + 8 of the last layer.
fn keep(four: u32, eight: u32, s: Sums) {
    let column = run.capacity / 4u;
    let at = 8u * eight * column + four;
    latent[at] = s[0];
    latent[at + HALF] = s[8];
    latent[at + column] = s[1];
    latent[at + column + HALF] = s[9];
    latent[at + 2u * column] = s[2];
    latent[at + 2u * column + HALF] = s[10];
    latent[at + 3u * column] = s[3];
    latent[at + 3u * column + HALF] = s[11];
    latent[at + 4u * column] = s[4];
    latent[at + 4u * column + HALF] = s[12];
    latent[at + 5u * column] = s[5];
    latent[at + 5u * column + HALF] = s[13];
    latent[at + 6u * column] = s[6];
    latent[at + 6u * column + HALF] = s[14];
    latent[at + 7u * column] = s[7];
    latent[at + 7u * column + HALF] = s[15];
}

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
    if DENSITY > 1u { advance(run.shapes[0], me, true); }
    let eight = eight_of(me);
    if 8u * eight < run.latents { keep(first + four_of(me), eight, ahead(run.shapes[DENSITY - 1u], four_of(me), eight)); }
}
