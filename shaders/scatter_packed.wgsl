// scatter_packed: as scatter, two features in one 64-bit word: half as many atomic operations.
//
// Source    as scatter. A word holds (q1 << 32) + q0; shared/quanta.wgsl takes it apart exactly.
// Twin      marf_field::cpu::encode::Scatter; the same quanta as scatter, to the bit.
// Threads   one per (8 samples, level): workgroup 64, folded over x and y; z counts the levels of this part.
// Reads     xyz [3][capacity] of visited samples, origin [capacity] (which of them a sample was), counts[slot], levels [L], slopes [L * FEATURES][capacity], scales [L]
// Writes    gradient [entries * FEATURES / 2] by integer atomicAdd; nothing where both contributions round to 0.
//           scales[level].clamped by atomicMax.
// Extremes  as scatter; q0 beyond 2^31 moves q1 by one quantum, too. Needs 64-bit integers and their atomics.
@group(0) @binding(6) var<storage, read_write> gradient: array<atomic<i64>>;

fn add(entry: u32, q: Quanta) {
    for (var f = 0u; f < FEATURES; f += 2u) {
        if q[f] != 0 || q[f + 1u] != 0 {
            atomicAdd(&gradient[(entry * FEATURES + f) / 2u], (i64(q[f + 1u]) << 32u) + i64(q[f]));
        }
    }
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    spread(EACH * flat(id, groups), min(counts[part.slot], part.capacity), part.level + id.z);
}
