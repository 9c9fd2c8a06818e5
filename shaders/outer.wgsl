// outer: gradient of a layer's weights, a part for every chunk of samples: G = sum over samples of A D^T.
//
// Source    none; parts that `sum` adds in an order of its own, so that no thread decides a rounding.
// Twin      marf_field::cpu::gemm::Outer over one chunk; the same chain in the order of samples. Equal to the bit where
//           fma is fused, else within 1e-6 of the sum of the sizes of the terms.
// Threads   one per (chunk, 4 rows of A, 8 rows of D), tiles of a chunk next to each other: workgroup 64, folded.
// Reads     a [first_a + inner][capacity], d [first_d + outputs][capacity], counts[slot] samples in use
// Writes    parts [chunks][inner][outputs] of chunks that hold samples, each element once; no others
// Extremes  samples beyond those in use count as 0 whatever is there, NaN too. No sample: nothing is written.
struct OuterRun {
    inner: u32,
    outputs: u32,
    capacity: u32,
    slot: u32,
    chunk: u32,
    first_a: u32,
    first_d: u32,
    pad0: u32,
}
@group(0) @binding(0) var<uniform> run: OuterRun;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> a: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> d: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> parts: array<vec4<f32>>;

// Four samples of four rows; of the samples those below `in_use`, the others 0. Column j of the result is sample j.
fn samples(r0: vec4<f32>, r1: vec4<f32>, r2: vec4<f32>, r3: vec4<f32>, first: u32, in_use: u32) -> mat4x4<f32> {
    if first + 4u <= in_use {
        return transpose(mat4x4<f32>(r0, r1, r2, r3));
    }
    let live = vec4<u32>(first, first + 1u, first + 2u, first + 3u) < vec4<u32>(in_use);
    let none = vec4<f32>(0.0);
    return transpose(mat4x4<f32>(
        select(none, r0, live), select(none, r1, live), select(none, r2, live), select(none, r3, live)
    ));
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let across = run.outputs / 8u;
    let tiles = run.inner / 4u * across;
    let thread = flat(id, groups);
    let chunk = thread / tiles;
    let row = thread % tiles / across;
    let eight = thread % tiles % across;
    let in_use = counts[run.slot];
    let begin = chunk * run.chunk;
    if begin >= in_use { return; }
    let end = min(begin + run.chunk, in_use);
    let column = run.capacity / 4u;
    let from_a = (run.first_a + 4u * row) * column;
    let from_d = (run.first_d + 8u * eight) * column;
    var l0 = vec4<f32>(0.0);
    var l1 = l0;
    var l2 = l0;
    var l3 = l0;
    var h0 = l0;
    var h1 = l0;
    var h2 = l0;
    var h3 = l0;
    for (var first = begin; first < end; first += 4u) {
        let p = from_a + first / 4u;
        let q = from_d + first / 4u;
        let x = samples(a[p], a[p + column], a[p + 2u * column], a[p + 3u * column], first, in_use);
        let low = samples(d[q], d[q + column], d[q + 2u * column], d[q + 3u * column], first, in_use);
        let q4 = q + 4u * column;
        let high = samples(d[q4], d[q4 + column], d[q4 + 2u * column], d[q4 + 3u * column], first, in_use);
        // Sample by sample, in their order.
        l0 = fma(vec4<f32>(x[0].x), low[0], l0);
        l1 = fma(vec4<f32>(x[0].y), low[0], l1);
        l2 = fma(vec4<f32>(x[0].z), low[0], l2);
        l3 = fma(vec4<f32>(x[0].w), low[0], l3);
        h0 = fma(vec4<f32>(x[0].x), high[0], h0);
        h1 = fma(vec4<f32>(x[0].y), high[0], h1);
        h2 = fma(vec4<f32>(x[0].z), high[0], h2);
        h3 = fma(vec4<f32>(x[0].w), high[0], h3);
        l0 = fma(vec4<f32>(x[1].x), low[1], l0);
        l1 = fma(vec4<f32>(x[1].y), low[1], l1);
        l2 = fma(vec4<f32>(x[1].z), low[1], l2);
        l3 = fma(vec4<f32>(x[1].w), low[1], l3);
        h0 = fma(vec4<f32>(x[1].x), high[1], h0);
        h1 = fma(vec4<f32>(x[1].y), high[1], h1);
        h2 = fma(vec4<f32>(x[1].z), high[1], h2);
        h3 = fma(vec4<f32>(x[1].w), high[1], h3);
        l0 = fma(vec4<f32>(x[2].x), low[2], l0);
        l1 = fma(vec4<f32>(x[2].y), low[2], l1);
        l2 = fma(vec4<f32>(x[2].z), low[2], l2);
        l3 = fma(vec4<f32>(x[2].w), low[2], l3);
        h0 = fma(vec4<f32>(x[2].x), high[2], h0);
        h1 = fma(vec4<f32>(x[2].y), high[2], h1);
        h2 = fma(vec4<f32>(x[2].z), high[2], h2);
        h3 = fma(vec4<f32>(x[2].w), high[2], h3);
        l0 = fma(vec4<f32>(x[3].x), low[3], l0);
        l1 = fma(vec4<f32>(x[3].y), low[3], l1);
        l2 = fma(vec4<f32>(x[3].z), low[3], l2);
        l3 = fma(vec4<f32>(x[3].w), low[3], l3);
        h0 = fma(vec4<f32>(x[3].x), high[3], h0);
        h1 = fma(vec4<f32>(x[3].y), high[3], h1);
        h2 = fma(vec4<f32>(x[3].z), high[3], h2);
        h3 = fma(vec4<f32>(x[3].w), high[3], h3);
    }
    let width = run.outputs / 4u;
    let to = (chunk * run.inner + 4u * row) * width + 2u * eight;
    parts[to] = l0;
    parts[to + 1u] = h0;
    parts[to + width] = l1;
    parts[to + width + 1u] = h1;
    parts[to + 2u * width] = l2;
    parts[to + 2u * width + 1u] = h2;
    parts[to + 3u * width] = l3;
    parts[to + 3u * width + 1u] = h3;
}
