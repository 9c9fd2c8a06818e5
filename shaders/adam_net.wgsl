// adam_net: one step of Adam for all networks and the background, in rows of 16 numbers. Then their running average.
//
// Source    Kingma and Ba, arXiv 1412.6980, algorithm 1. Rows without a gradient keep everything.
// Twin      marf_field::cpu::adam::Adam::<16> with its decay, within 1e-6 of the step: root and quotient may be rounded
//           otherwise. The average is marf_field::learn::blend.
// Threads   one per row: workgroup 64, folded.
// Reads     `gradient` [rows][16], `bias` [last + 1] (corrections by step count), `faults` [FAULT_SLOTS]. `pace.rate`
//           is the step size. `pace.keep` is the share that the average keeps: 1 leaves it unchanged.
// Writes    `weights`, `mean`, `square` [rows][16] and `count` [rows] of rows with a gradient. `gradient` becomes 0.
//           `average` [rows][16].
// Extremes  any fault: nothing is written. Zeros of both signs are not a gradient. A gradient above 1.8e19 makes the
//           second moment infinite, and its row does not move. A count above `last` takes the last correction.
struct AdamNet {
    rows: u32,
    last: u32,
    // First row of the background, which has a step size of its own and no pull to zero.
    behind: u32,
    factor: f32,
    decay: f32,
    epsilon: f32,
    beta1: f32,
    beta2: f32,
}
@group(0) @binding(0) var<uniform> run: AdamNet;
@group(0) @binding(1) var<uniform> pace: Pace;
@group(0) @binding(2) var<storage, read> faults: array<vec4<u32>, FAULT_SLOTS / 4u>;
@group(0) @binding(3) var<storage, read> bias: array<vec2<f32>>;
@group(0) @binding(4) var<storage, read_write> weights: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> gradient: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> mean: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> square: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> count: array<u32>;
@group(0) @binding(9) var<storage, read_write> average: array<vec4<f32>>;

fn advance(at: u32, rate: f32, decay: f32, correction: vec2<f32>) {
    let weight = weights[at];
    let slope = fma(vec4<f32>(decay), weight, gradient[at]);
    let m = fma(vec4<f32>(run.beta1), mean[at], (1.0 - run.beta1) * slope);
    let v = fma(vec4<f32>(run.beta2), square[at], (1.0 - run.beta2) * (slope * slope));
    let root = sqrt(v * correction.y) + run.epsilon;
    weights[at] = weight - rate * (m * correction.x) / root;
    mean[at] = m;
    square[at] = v;
    gradient[at] = vec4<f32>(0.0);
}

fn learn(row: u32) {
    let at = 4u * row;
    let touched = bitcast<vec4<u32>>(gradient[at])
        | bitcast<vec4<u32>>(gradient[at + 1u])
        | bitcast<vec4<u32>>(gradient[at + 2u])
        | bitcast<vec4<u32>>(gradient[at + 3u]);
    if ((touched.x | touched.y | touched.z | touched.w) << 1u) == 0u { return; }
    let steps = count[row];
    let correction = bias[min(steps, run.last)];
    count[row] = select(steps, steps + 1u, steps < 0xffffffffu);
    let is_behind = row >= run.behind;
    let rate = pace.rate * select(1.0, run.factor, is_behind);
    let decay = select(run.decay, 0.0, is_behind);
    advance(at, rate, decay, correction);
    advance(at + 1u, rate, decay, correction);
    advance(at + 2u, rate, decay, correction);
    advance(at + 3u, rate, decay, correction);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let row = flat(id, groups);
    if row >= run.rows || faulted() { return; }
    learn(row);
    if pace.keep >= 1.0 { return; }
    for (var at = 4u * row; at < 4u * row + 4u; at++) {
        average[at] += (1.0 - pace.keep) * (weights[at] - average[at]);
    }
}
