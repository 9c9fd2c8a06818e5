// scatter_packed: as scatter, two features in one 64-bit word: half as many atomic operations.
//
// Source    as scatter. A word holds (q1 << 32) + q0. shared/quanta.wgsl splits it exactly.
// Twin      marf_field::cpu::encode::Scatter, the same quanta as scatter, to the bit.
// Threads   one per (8 samples, level): workgroup 64, folded over x and y. z counts the levels of this part.
// Reads     `xyz` [3][capacity] of visited samples, `origin` [capacity] (the visited sample of each), `counts`[slot],
//           `levels` [L], `slopes` [L * FEATURES][capacity], `scales` [L].
// Writes    `gradient` [entries * FEATURES / 2] by integer atomicAdd. Nothing where both contributions round to 0.
//           `scales`[level].clamped by atomicMax.
// Extremes  as scatter. q0 beyond 2^31 moves q1 by one quantum, too. Needs 64-bit integers and their atomics.
@group(0) @binding(6) var<storage, read_write> gradient: array<atomic<i64>>;

fn add_pair(at: u32, low: i32, high: i32) {
    if low != 0 || high != 0 { atomicAdd(&gradient[at], (i64(high) << 32u) + i64(low)); }
}

// FEATURES is 2 or 4: constants index the vector, as a loop would put it into the memory of a card.
fn add(entry: u32, q: Quanta) {
    let at = entry * FEATURES / 2u;
    add_pair(at, q.x, q.y);
    if FEATURES > 2u { add_pair(at + 1u, q[FEATURES / 2u], q[FEATURES - 1u]); }
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    spread(EACH * flat(id, groups), min(counts[part.slot], part.capacity), part.level + id.z);
}
