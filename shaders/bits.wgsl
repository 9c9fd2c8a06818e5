// bits: decides again for every cell whether rays visit it.
//
// Source    instant-ngp, arXiv 2201.05989, appendix on occupancy grids. Empty cells may have an own threshold.
// Twin      marf_field::occupancy::Occupancy::update, last loop. Equal except where a density is within 1e-5 relative
//           of its threshold, which is a sum of floats.
// Threads   one per word of 32 cells: workgroup 64, folded over x and y.
// Reads     `density` [cells], `least` [2] from thresholds, `faults` [FAULT_SLOTS].
// Writes    `bits` [cells / 32] of u32, each exactly once. Nothing where a fault is set.
// Extremes  a cell that no camera sees (density < 0) is empty. Bits beyond the last cell are 0.
@group(0) @binding(0) var<uniform> filling: Filling;
@group(0) @binding(1) var<storage, read> faults: array<vec4<u32>, FAULT_SLOTS / 4u>;
@group(0) @binding(2) var<storage, read> density: array<f32>;
@group(0) @binding(3) var<storage, read> least: array<f32>;
@group(0) @binding(4) var<storage, read_write> bits: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let at = flat(id, groups);
    if at >= arrayLength(&bits) || faulted() {
        return;
    }
    let before = bits[at];
    var word = 0u;
    for (var bit = 0u; bit < 32u; bit++) {
        let cell = at * 32u + bit;
        if cell < filling.cells {
            let value = density[cell];
            let from_here = select(least[1], least[0], ((before >> bit) & 1u) == 1u);
            word |= u32(value >= from_here && value >= 0.0) << bit;
        }
    }
    bits[at] = word;
}
