// scatter: transpose of hash_encode, gradients of features to gradients of table entries.
//
// Source    instant-ngp, arXiv 2201.05989, section 3, eq. 4. Fixed point, one scale a level, a power of two.
// Twin      marf_field::cpu::encode::Scatter. Every contribution is off by half a quantum, 0.5 / scale, at most.
// Threads   one per (8 samples, level): workgroup 64, folded over x and y. z counts the levels of this part.
// Reads     `xyz` [3][capacity] of visited samples, `origin` [capacity] (the visited sample of each), `counts`[slot],
//           `levels` [L], `slopes` [L * FEATURES][capacity], `scales` [L].
// Writes    `gradient` [entries * FEATURES] by integer atomicAdd: any order gives the same bits. Nothing where a
//           contribution rounds to 0. `scales`[level].clamped by atomicMax.
// Extremes  a contribution of more than MOST_QUANTA, inf or NaN counts as MOST_QUANTA with its sign and marks the
//           level, which is then left out (rescale). A sum may wrap beyond 2^31: peaks are kept at 2^25 for that.
@group(0) @binding(6) var<storage, read_write> gradient: array<atomic<i32>>;

fn add_one(at: u32, q: i32) {
    if q != 0 { atomicAdd(&gradient[at], q); }
}

// FEATURES is 2 or 4: constants index the vector, as a loop would put it into the memory of a card.
fn add(entry: u32, q: Quanta) {
    let at = entry * FEATURES;
    add_one(at, q.x);
    add_one(at + 1u, q.y);
    if FEATURES > 2u {
        add_one(at + 2u, q[FEATURES / 2u]);
        add_one(at + 3u, q[FEATURES - 1u]);
    }
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    spread(EACH * flat(id, groups), min(counts[part.slot], part.capacity), part.level + id.z);
}
