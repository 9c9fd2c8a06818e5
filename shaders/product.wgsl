// product: one layer for all samples, forward or backward: C = after(A B).
//
// Source    the micro kernel of the CPU, turned: lanes are samples, 8 outputs a thread stay in registers.
// Twin      marf_field::cpu::gemm::Product; the same chain of fused multiply-adds in the order of k. Equal to the bit
//           where fma is fused, else within 1e-6 of the sum of the sizes of the terms.
// Threads   one per (4 samples, 8 outputs): workgroup 64 x 1, dispatch (capacity / 256, outputs / 8).
// Reads     a [first_a + inner][capacity], b [inner][outputs], counts[slot] samples in use;
//           `gated` also gate [outputs][capacity]
// Writes    c rows first_c .. first_c + outputs, samples in use rounded up to 4; each element once
// Extremes  NaN passes through a ReLU, which compares 0 > x. What the up to 3 samples beyond those in use hold is
//           never mixed with others. No sample: nothing is written.
struct ProductRun {
    inner: u32,
    outputs: u32,
    capacity: u32,
    slot: u32,
    first_a: u32,
    first_c: u32,
    pad0: u32,
    pad1: u32,
}
@group(0) @binding(0) var<uniform> run: ProductRun;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> a: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> b: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> c: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> gate: array<vec4<f32>>;

// One vector of 4 samples for each of 8 outputs.
alias Sums = array<vec4<f32>, 8>;

fn sums_at(four: u32, eight: u32) -> Sums {
    let column = run.capacity / 4u;
    let row = run.outputs / 4u;
    var s0 = vec4<f32>(0.0);
    var s1 = s0;
    var s2 = s0;
    var s3 = s0;
    var s4 = s0;
    var s5 = s0;
    var s6 = s0;
    var s7 = s0;
    var at = run.first_a * column + four;
    var weight = 2u * eight;
    for (var k = 0u; k < run.inner; k++) {
        let x = a[at];
        let low = b[weight];
        let high = b[weight + 1u];
        s0 = fma(x, vec4<f32>(low.x), s0);
        s1 = fma(x, vec4<f32>(low.y), s1);
        s2 = fma(x, vec4<f32>(low.z), s2);
        s3 = fma(x, vec4<f32>(low.w), s3);
        s4 = fma(x, vec4<f32>(high.x), s4);
        s5 = fma(x, vec4<f32>(high.y), s5);
        s6 = fma(x, vec4<f32>(high.z), s6);
        s7 = fma(x, vec4<f32>(high.w), s7);
        at += column;
        weight += row;
    }
    return Sums(s0, s1, s2, s3, s4, s5, s6, s7);
}

fn put(four: u32, eight: u32, sums: Sums) {
    let column = run.capacity / 4u;
    let at = (run.first_c + 8u * eight) * column + four;
    c[at] = sums[0];
    c[at + column] = sums[1];
    c[at + 2u * column] = sums[2];
    c[at + 3u * column] = sums[3];
    c[at + 4u * column] = sums[4];
    c[at + 5u * column] = sums[5];
    c[at + 6u * column] = sums[6];
    c[at + 7u * column] = sums[7];
}

fn relu(x: vec4<f32>) -> vec4<f32> {
    return select(x, vec4<f32>(0.0), vec4<f32>(0.0) > x);
}

fn opened(x: vec4<f32>, at: u32) -> vec4<f32> {
    return select(vec4<f32>(0.0), x, gate[at] > vec4<f32>(0.0));
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if 4u * id.x >= counts[run.slot] { return; }
    put(id.x, id.y, sums_at(id.x, id.y));
}

@compute @workgroup_size(64)
fn rectified(@builtin(global_invocation_id) id: vec3<u32>) {
    if 4u * id.x >= counts[run.slot] { return; }
    let s = sums_at(id.x, id.y);
    put(id.x, id.y, Sums(
        relu(s[0]), relu(s[1]), relu(s[2]), relu(s[3]), relu(s[4]), relu(s[5]), relu(s[6]), relu(s[7])
    ));
}

@compute @workgroup_size(64)
fn gated(@builtin(global_invocation_id) id: vec3<u32>) {
    if 4u * id.x >= counts[run.slot] { return; }
    let s = sums_at(id.x, id.y);
    let column = run.capacity / 4u;
    let at = 8u * id.y * column + id.x;
    put(id.x, id.y, Sums(
        opened(s[0], at),
        opened(s[1], at + column),
        opened(s[2], at + 2u * column),
        opened(s[3], at + 3u * column),
        opened(s[4], at + 4u * column),
        opened(s[5], at + 5u * column),
        opened(s[6], at + 6u * column),
        opened(s[7], at + 7u * column),
    ));
}
