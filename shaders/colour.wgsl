// colour: logits of the colour network to colours.
//
// Source    none; logits are cut at +-LOGIT_LIMIT (0.99995, beyond 8 bits).
// Twin      marf_field::cpu::composite::Colours; within 1e-6. Of the 16 logits only the 3 that are used are checked.
// Threads   one per sample: workgroup 64, folded.
// Reads     logits [16][capacity] rows 0 to 2, counts[slot] samples in use
// Writes    rgb [3][capacity], sRGB in (0, 1), samples in use, each element once; faults[FAULT_LOGITS] where a logit runs away
// Extremes  NaN counts as the upper limit and is a fault.
@group(0) @binding(0) var<uniform> extent: Extent;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> logits: array<f32>;
@group(0) @binding(3) var<storage, read_write> rgb: array<f32>;
@group(0) @binding(4) var<storage, read_write> faults: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let sample = flat(id, groups);
    if sample >= counts[extent.slot] { return; }
    var is_wild = false;
    for (var channel = 0u; channel < 3u; channel++) {
        let at = channel * extent.capacity + sample;
        let logit = logits[at];
        is_wild = is_wild || runs_away(logit);
        rgb[at] = colour_of(logit);
    }
    if is_wild { atomicMax(&faults[FAULT_LOGITS], 1u); }
}
