// What changes from step to step.
struct Pace {
    // Learning rate.
    rate: f32,
    // Place in the ring of totals.
    total: u32,
    pad0: u32,
    pad1: u32,
}
