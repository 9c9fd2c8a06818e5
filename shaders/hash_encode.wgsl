// hash_encode: multiresolution hash-grid lookup, forward pass.
//
// Source    instant-ngp, arXiv 2201.05989, section 3, eq. 4. FEATURES = 2 or 4 numbers an entry.
// Twin      marf_field::cpu::encode::Lookup: same corners, same hash, same order of sums. Where a GPU contracts x *
//           resolution - cell, a weight moves by resolution * 2^-24 (gpu/tables/encode.rs).
// Threads   one per (sample, level): workgroup 64, folded over x and y. z counts the levels of this part.
// Reads     `xyz` [3][capacity] in the unit box, `counts`[slot], `levels` [L], `table` [entries] of Row from entry
//           `base` on.
// Writes    `features` [L * FEATURES][capacity], rows of its levels, samples in use: each element exactly once.
// Extremes  x = 1 belongs to the last cell. Outside and NaN count as the border (NaN as 0), as on the CPU. The
//           resolution comes from the CPU: floor(base * growth^l) may differ by one.
@group(0) @binding(0) var<uniform> part: GridPart;
@group(0) @binding(1) var<storage, read> levels: array<GridLevel>;
@group(0) @binding(2) var<storage, read> counts: array<u32>;
@group(0) @binding(3) var<storage, read> xyz: array<f32>;
@group(0) @binding(4) var<storage, read> table: array<Row>;
@group(0) @binding(5) var<storage, read_write> features: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let sample = flat(id, groups);
    let capacity = part.capacity;
    if sample >= min(counts[part.slot], capacity) {
        return;
    }
    let number = part.level + id.z;
    let level = levels[number];
    let at = vec3<f32>(unit(xyz[sample]), unit(xyz[capacity + sample]), unit(xyz[2u * capacity + sample]));
    let q = at * f32(level.resolution);
    let cell = cell_of(q, level.resolution);
    let share = q - vec3<f32>(cell);
    let weights = across(share);
    let first = level.first - part.base;
    var below = Row(0.0);
    var above = Row(0.0);
    for (var side = 0u; side < 4u; side++) {
        let weight = Row(weights[side]);
        below = fma(weight, table[first + entry_of(level, cell, 2u * side)], below);
        above = fma(weight, table[first + entry_of(level, cell, 2u * side + 1u)], above);
    }
    let mean = fma(Row(1.0 - share.x), below, share.x * above);
    for (var f = 0u; f < FEATURES; f++) {
        features[(number * FEATURES + f) * capacity + sample] = mean[f];
    }
}
