// rescale: decides for every level whether its gradient counts, and the scale of the next one.
//
// Source    none: fixed point with a scale that follows the largest sum.
// Twin      the function `rescaled` of the tests in gpu/tables/scales.rs, equal.
// Threads   one per level: workgroup 64, dispatch 1.
// Reads     `scales` [L]: scale, peak, clamped. `faults` [FAULT_SLOTS].
// Writes    `scales` [L]: scale (next), quantum (1 / scale of this gradient), skip, overflows, and peak, clamped to 0.
//           Nothing where a fault is set.
// Extremes  peak above `most` or clamped: the level is skipped and its scale falls by 2^back_off. Else the scale is the
//           largest power of two with peak * (next / now) <= 2^target, at most 2^rise times the scale now. A peak of 0
//           keeps it. Always within [2^lowest, 2^highest].
struct Rescaling {
    // Levels.
    levels: u32,
    // log2 of the peak that is aimed at.
    target_bits: i32,
    // Largest peak that counts.
    most: u32,
    // log2 of what the scale falls by after an overflow.
    back_off: i32,
    // log2 of the smallest scale.
    lowest: i32,
    // log2 of the largest scale.
    highest: i32,
    // log2 of what a scale rises by at most.
    rise: i32,
    pad0: u32,
}
@group(0) @binding(0) var<uniform> rescaling: Rescaling;
@group(0) @binding(1) var<storage, read_write> scales: array<LevelScale>;
@group(0) @binding(2) var<storage, read> faults: array<vec4<u32>, FAULT_SLOTS / 4u>;

// 2^n, of -126 <= n <= 127.
fn power(n: i32) -> f32 {
    return bitcast<f32>(u32(n + 127) << 23u);
}

// Smallest n with x <= 2^n, of x >= 1.
fn log2_above(x: u32) -> i32 {
    return 32 - i32(countLeadingZeros(x - 1u));
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let level = id.x;
    if level >= rescaling.levels || faulted() {
        return;
    }
    var state = scales[level];
    let now = i32(bitcast<u32>(state.scale) >> 23u) - 127;
    var next = now;
    let over = state.peak > rescaling.most || state.clamped != 0u;
    if over {
        next = now - rescaling.back_off;
        state.overflows += 1u;
    } else if state.peak != 0u {
        next = now + min(rescaling.target_bits - log2_above(state.peak), rescaling.rise);
    }
    state.quantum = power(-now);
    state.scale = power(clamp(next, rescaling.lowest, rescaling.highest));
    state.skip = u32(over);
    state.peak = 0u;
    state.clamped = 0u;
    scales[level] = state;
}
