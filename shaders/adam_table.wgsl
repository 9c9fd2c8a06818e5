// adam_table: one step of Adam over the rows of tables, gradients in fixed point. Then their running average.
//
// Source    Kingma and Ba, arXiv 1412.6980, algorithm 1. Rows without gradient are skipped whole.
// Twin      marf_field::cpu::adam::Adam<FEATURES> with epsilon + quantum. Weights are equal within 1e-5 rates a step
//           and 1e-6 of their size (gpu/tables/adam.rs). The average is marf_field::learn::blend, equal within one
//           rounding of the larger: a GPU may contract the sum.
// Threads   64 for 64 ROWS entries of a level, each every 64th: workgroup 64, folded over x and y. z counts the levels
//           of this part.
// Reads     `rates`. `scales` [L]: quantum, skip, first, entries. `bias` [4096] of 1 / (1 - beta^n). `faults`
//           [FAULT_SLOTS].
// Writes    `weights`, `mean`, `square` [entries] of Row, `count` [entries], `gradient` [entries] of Quanta to 0, from
//           entry `base` on. Nothing where a fault is set or all quanta are 0. Only the gradient where the level is
//           skipped. Where `keep` is below 1, also `average` [entries] of Row, each once, unless a fault is set.
// Extremes  epsilon grows by a quantum: the least gradient moves a weight by half a rate at most. The count stays at
//           2^32 - 1. Beyond the table of bias, the last one is used. A keep of 0 takes the weights except for a
//           rounding.
struct Rates {
    rate: f32,
    epsilon: f32,
    decay: f32,
    beta1: f32,
    beta2: f32,
    // Share of itself that the average keeps. 1 where it stays.
    keep: f32,
    pad0: f32,
    pad1: f32,
}
@group(0) @binding(0) var<uniform> part: GridPart;
@group(0) @binding(1) var<uniform> rates: Rates;
@group(0) @binding(2) var<storage, read> scales: array<LevelScale>;
@group(0) @binding(3) var<storage, read> bias: array<vec2<f32>>;
@group(0) @binding(4) var<storage, read> faults: array<vec4<u32>, FAULT_SLOTS / 4u>;
@group(0) @binding(5) var<storage, read_write> gradient: array<Quanta>;
@group(0) @binding(6) var<storage, read_write> weights: array<Row>;
@group(0) @binding(7) var<storage, read_write> mean: array<Row>;
@group(0) @binding(8) var<storage, read_write> square: array<Row>;
@group(0) @binding(9) var<storage, read_write> count: array<u32>;
@group(0) @binding(10) var<storage, read_write> average: array<Row>;

fn learn(level: LevelScale, at: u32) {
    let q = quanta_of(gradient[at]);
    if all(q == Quanta(0)) {
        return;
    }
    gradient[at] = Quanta(0);
    if level.skip != 0u {
        return;
    }
    let n = count[at];
    count[at] = select(n + 1u, n, n == 0xffffffffu);
    let correction = bias[min(n, arrayLength(&bias) - 1u)];
    let weight = weights[at];
    let slope = fma(Row(rates.decay), weight, Row(q) * level.quantum);
    let first = fma(Row(rates.beta1), mean[at], (1.0 - rates.beta1) * slope);
    let second = fma(Row(rates.beta2), square[at], (1.0 - rates.beta2) * (slope * slope));
    let root = sqrt(second * correction.y) + (rates.epsilon + level.quantum);
    mean[at] = first;
    square[at] = second;
    weights[at] = weight - rates.rate * (first * correction.x) / root;
}

@compute @workgroup_size(64)
fn main(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    if faulted() {
        return;
    }
    let thread = flat(id, groups);
    let level = scales[part.level + id.z];
    let first = (thread - lane) * ROWS + lane;
    let end = min(first + 64u * ROWS, level.entries);
    for (var row = first; row < end; row += 64u) {
        let at = level.first - part.base + row;
        learn(level, at);
        if rates.keep < 1.0 { average[at] += (1.0 - rates.keep) * (weights[at] - average[at]); }
    }
}
