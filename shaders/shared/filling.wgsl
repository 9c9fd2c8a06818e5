// Inputs of all kernels of the occupancy grid but `probe`.
struct Filling {
    // Cells of the grid.
    cells: u32,
    // Partial sums.
    parts: u32,
    // Slots of a pass of probes.
    capacity: u32,
    // 1 where empty cells fill at the density of occupied ones, 0 where it shows by itself.
    at_mean: u32,
    // Share of a density that remains when its cell is probed again.
    decay: f32,
    // Density of a cell that has not been looked at.
    unknown: f32,
    // Density that shows in a step of the shortest length.
    shows: f32,
    // Added to the raw density before the exponential.
    shift: f32,
    // Place in `counts` of the number of probes.
    slot: u32,
}

// Sum and number of some densities.
struct Tally {
    sum: f32,
    count: u32,
}
