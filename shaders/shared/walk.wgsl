// Sizes and limits of a walk along rays.
struct Walk {
    // Rays in use, and slots for rays: columns of `spans` are that long.
    rays: u32,
    ray_slots: u32,
    // Slots for samples.
    capacity: u32,
    // A ray pauses after the block of 16 steps in which it reaches this many samples, at least 1.
    limit: u32,
    // Steps, and steps with those that fill up the last block.
    steps: u32,
    padded: u32,
    // Cells a side of the occupancy grid.
    side: u32,
    // 1 where rays continue from next_step, 0 where all begin at the first step and end at the last.
    resumes: u32,
    // Place in `counts` of the number of samples.
    slot: u32,
    // 1 where `counts` already has which rays are in use: those whose samples once fitted.
    again: u32,
}

// First sample of a ray whose samples do not fit. Its count is 0.
const CLIPPED: u32 = 0xffffffffu;
