// paint: takes the samples of a round into the rays of a picture.
//
// Source    NeRF, arXiv 2003.08934, eq. 3.
// Twin      marf_field::render::Gather, within 1e-6.
// Threads   one per ray, its samples from the front: workgroup 64, folded.
// Reads     `spans` [4][rays] (of visited samples, of kept ones: the first of the visited). `light` [3][capacity]
//           (alpha, transmittance), `rgb` [3][capacity] of kept samples. `along` [3][capacity] (row 0, the distance).
//           `shown` [2][rays] of `opacity` (bits of the round's optical depth). `counts`[slot] rays in use.
// Writes    `state` [6][rays] of rays in use: optical depth, rgb, distance, remaining transmittance. The samples are
//           added to its values. `begin` sets all rays to 0, 0, 0, 1.
// Extremes  a ray without samples stays as it is. Behind an optical depth of `deep` the remaining transmittance is at
//           most half of OPAQUE, so that the ray ends.
struct PaintRun {
    slot: u32,
    capacity: u32,
    rays: u32,
    deep: f32,
}
@group(0) @binding(0) var<uniform> run: PaintRun;
@group(0) @binding(1) var<storage, read_write> state: array<f32>;
@group(0) @binding(2) var<storage, read> counts: array<u32>;
@group(0) @binding(3) var<storage, read> spans: array<u32>;
@group(0) @binding(4) var<storage, read> light: array<f32>;
@group(0) @binding(5) var<storage, read> rgb: array<f32>;
@group(0) @binding(6) var<storage, read> along: array<f32>;
@group(0) @binding(7) var<storage, read> shown: array<u32>;

@compute @workgroup_size(64)
fn begin(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let ray = flat(id, groups);
    if ray >= run.rays { return; }
    for (var row = 0u; row < 5u; row++) { state[row * run.rays + ray] = 0.0; }
    state[5u * run.rays + ray] = 1.0;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let ray = flat(id, groups);
    if ray >= run.rays || ray >= counts[run.slot] { return; }
    let depth = state[ray] + bitcast<f32>(shown[run.rays + ray]);
    var sum = vec3<f32>(state[run.rays + ray], state[2u * run.rays + ray], state[3u * run.rays + ray]);
    var distance = state[4u * run.rays + ray];
    var left = state[5u * run.rays + ray];
    let first = spans[2u * run.rays + ray];
    let end = first + spans[3u * run.rays + ray];
    let shift = spans[ray] - first;
    for (var sample = first; sample < end; sample++) {
        let transmittance = light[2u * run.capacity + shift + sample];
        let weight = transmittance * light[run.capacity + shift + sample];
        let shade = vec3<f32>(rgb[sample], rgb[run.capacity + sample], rgb[2u * run.capacity + sample]);
        sum = fma(vec3<f32>(weight), shade, sum);
        distance = fma(weight, along[shift + sample], distance);
        left = transmittance - weight;
    }
    let least = OPAQUE * 0.5;
    if depth > run.deep { left = select(least, left, left < least); }
    state[ray] = depth;
    state[run.rays + ray] = sum.x;
    state[2u * run.rays + ray] = sum.y;
    state[3u * run.rays + ray] = sum.z;
    state[4u * run.rays + ray] = distance;
    state[5u * run.rays + ray] = left;
}
