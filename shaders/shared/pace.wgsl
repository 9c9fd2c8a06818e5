// What changes from step to step.
struct Pace {
    // Learning rate.
    rate: f32,
    // Place in the ring of totals.
    total: u32,
    // Share of themselves that the averages of the networks keep. 1 where they stay.
    keep: f32,
    pad0: u32,
}
