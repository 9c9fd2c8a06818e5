// probe: chooses cells of the occupancy grid to probe, and a random point in each.
//
// Source    instant-ngp, arXiv 2201.05989, appendix on occupancy grids. Cells are chosen by number, not at random.
// Twin      marf_field::occupancy::Occupancy::probes, equal to the bit where the side is a power of two, else a
//           division may round differently.
// Threads   one per candidate of this pass: workgroup 64, folded over x and y.
// Reads     `density` [side^3], `bits` [side^3 / 32] of u32.
// Writes    `counts`[slot] by atomicAdd, from 0: probes of this pass. `cells` [capacity]: number of the cell of a
//           probe. `xyz` [3][capacity]: its point. The threads decide which probe gets which slot: a cell's density
//           does not depend on its slot, and there are as many slots as candidates.
// Extremes  no cell beyond the last, and no cell that no camera sees (density < 0).
struct Probing {
    seed: vec2<u32>,
    // Number of the update.
    round: vec2<u32>,
    // Purpose of the random numbers.
    purpose: u32,
    // Slots of a pass.
    capacity: u32,
    // The pass' first candidate.
    first: u32,
    // Cells a side.
    side: u32,
    // Candidate j is cell `every` j + `offset`: one cell in `every`.
    every: u32,
    offset: u32,
    // Of empty cells one in `empty`: where `factor` cell + `phase` is a multiple of it.
    empty: u32,
    factor: u32,
    phase: u32,
    // Place in `counts` of the number of probes.
    slot: u32,
    pad0: u32,
    pad1: u32,
}
@group(0) @binding(0) var<uniform> probing: Probing;
@group(0) @binding(1) var<storage, read> density: array<f32>;
@group(0) @binding(2) var<storage, read> bits: array<u32>;
@group(0) @binding(3) var<storage, read_write> cells: array<u32>;
@group(0) @binding(4) var<storage, read_write> xyz: array<f32>;
@group(0) @binding(5) var<storage, read_write> counts: array<atomic<u32>>;

fn is_due(cell: u32) -> bool {
    if density[cell] < 0.0 {
        return false;
    }
    let occupied = ((bits[cell >> 5u] >> (cell & 31u)) & 1u) == 1u;
    return occupied || (probing.factor * cell + probing.phase) % probing.empty == 0u;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let candidate = flat(id, groups);
    let capacity = probing.capacity;
    let side = probing.side;
    let cell = (probing.first + candidate) * probing.every + probing.offset;
    if candidate >= capacity || cell >= side * side * side || !is_due(cell) {
        return;
    }
    var rng = rng_new(probing.seed, probing.purpose, probing.round, vec2<u32>(cell, 0u));
    let x = rng_unit(&rng);
    let y = rng_unit(&rng);
    let z = rng_unit(&rng);
    let corner = vec3<f32>(f32(cell % side), f32(cell / side % side), f32(cell / side / side));
    let at = (corner + vec3<f32>(x, y, z)) / f32(side);
    let slot = atomicAdd(&counts[probing.slot], 1u);
    cells[slot] = cell;
    xyz[slot] = at.x;
    xyz[capacity + slot] = at.y;
    xyz[2u * capacity + slot] = at.z;
}
