// peak: largest |quantum| of every level's gradient.
//
// Source    none: a maximum. Integers, so any order gives the same.
// Twin      a maximum over |q| (gpu/tables/scales.rs), equal.
// Threads   64 for 64 ROWS entries of a level, each every 64th: workgroup 64, folded over x and y. z counts the levels
//           of this part.
// Reads     `gradient` [entries] of Quanta from entry `base` on, `scales` [L]: first, entries.
// Writes    `scales`[level].peak by atomicMax, one a workgroup.
// Extremes  |-2^31| is 2^31, hence u32. All zero leaves peak as it was: rescale sets it to 0.
@group(0) @binding(0) var<uniform> part: GridPart;
@group(0) @binding(1) var<storage, read> gradient: array<Quanta>;
@group(0) @binding(2) var<storage, read_write> scales: array<LevelScale>;

var<workgroup> most: atomic<u32>;

@compute @workgroup_size(64)
fn main(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    // Workgroup memory may hold anything before.
    if lane == 0u { atomicStore(&most, 0u); }
    workgroupBarrier();
    let level = part.level + id.z;
    let first = (flat(id, groups) - lane) * ROWS + lane;
    let end = min(first + 64u * ROWS, scales[level].entries);
    let base = scales[level].first - part.base;
    var own = 0u;
    for (var row = first; row < end; row += 64u) {
        let sizes = bitcast<Sizes>(abs(quanta_of(gradient[base + row])));
        for (var f = 0u; f < FEATURES; f++) { own = max(own, sizes[f]); }
    }
    if own != 0u { atomicMax(&most, own); }
    workgroupBarrier();
    if lane == 0u {
        let peak = atomicLoad(&most);
        if peak != 0u {
            atomicMax(&scales[level].peak, peak);
        }
    }
}
