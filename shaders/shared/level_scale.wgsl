// One level's fixed point, for kernels that have it to themselves.
struct LevelScale {
    // Quanta a unit of gradient, a power of two, for what is added next.
    scale: f32,
    // 1 / scale of what was added last.
    quantum: f32,
    // Largest |q| of its entries.
    peak: u32,
    // 1 where a single contribution was clamped.
    clamped: u32,
    // 1 where this step leaves the level as it is.
    skip: u32,
    // Steps that were left out so far.
    overflows: u32,
    // First entry in the table of all levels.
    first: u32,
    // Entries.
    entries: u32,
}
