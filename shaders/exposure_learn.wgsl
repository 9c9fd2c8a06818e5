// exposure_learn: moves log gains and offsets of all photos, cuts them and subtracts their mean.
//
// Source    Adam, arXiv 1412.6980, algorithm 1, over rows of one photo. Rows without a slope keep everything.
// Twin      marf_field::learn::learn_exposures and marf_field::exposure::centre, marf_field::cpu::adam::Adam, within
//           1e-6: the order of the mean differs, and is that of the indices.
// Threads   one workgroup of 256, each every 256th photo: dispatch (1, 1).
// Reads     `step.rate`. `asked`. `sums` [2][views] vec4. `bias` [counts] 1 / (1 - decay^n) of both moments. `faults`
//           [FAULT_SLOTS].
// Writes    `gains`, `mean`, `square` [views or 2 views] vec4, `count` as many u32.
// Extremes  any fault: nothing changes. Counts beyond the last bias take the last. One photo alone: 0.
@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<uniform> asked: Exposed;
@group(0) @binding(2) var<storage, read> sums: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> bias: array<vec2<f32>>;
@group(0) @binding(4) var<storage, read> faults: array<vec4<u32>, FAULT_SLOTS / 4u>;
@group(0) @binding(5) var<storage, read_write> gains: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> mean: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> square: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> count: array<u32>;

const THREADS: u32 = 256u;

var<workgroup> totals: array<vec3<f32>, THREADS>;

// One row of Adam.
fn moved(row: u32) -> vec4<f32> {
    let slope = sums[row];
    let weight = gains[row];
    // Both zeros.
    if all((bitcast<vec4<u32>>(slope) << vec4(1u)) == vec4(0u)) { return weight; }
    let taken = count[row];
    let correction = bias[min(taken, arrayLength(&bias) - 1u)];
    count[row] = taken + select(1u, 0u, taken == 0xffffffffu);
    let left = vec2(1.0) - asked.decays;
    mean[row] = fma(vec4(asked.decays.x), mean[row], left.x * slope);
    square[row] = fma(vec4(asked.decays.y), square[row], left.y * (slope * slope));
    let root = sqrt(square[row] * correction.y) + asked.epsilon;
    return weight - step.rate * asked.share * (mean[row] * correction.x) / root;
}

fn cut(v: vec4<f32>, limit: f32) -> vec4<f32> {
    let above = select(vec4(-limit), v, v > vec4(-limit));
    return select(vec4(limit), above, above < vec4(limit));
}

// Moves the rows from `first` on, one a photo.
fn learn(first: u32, limit: f32, me: u32) {
    var sum = vec3(0.0);
    for (var view = me; view < asked.views; view += THREADS) {
        let number = cut(moved(first + view), limit);
        gains[first + view] = number;
        sum += number.xyz;
    }
    totals[me] = sum;
    for (var apart = THREADS / 2u; apart > 0u; apart /= 2u) {
        workgroupBarrier();
        if me < apart { totals[me] += totals[me + apart]; }
    }
    workgroupBarrier();
    let middle = vec4(totals[0] / f32(asked.views), 0.0);
    for (var view = me; view < asked.views; view += THREADS) { gains[first + view] -= middle; }
    workgroupBarrier();
}

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) me: u32) {
    // Uniform for all threads: faults are read only here.
    if faulted() { return; }
    learn(0u, asked.limits.x, me);
    if asked.offsets == 1u { learn(asked.views, asked.limits.y, me); }
}
