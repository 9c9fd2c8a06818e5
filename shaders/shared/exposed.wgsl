// Sizes and rates of the kernels of exposures.
struct Exposed {
    views: u32,
    // 1 where photos have offsets behind their gains.
    offsets: u32,
    // Slots there are for rays: columns of the slopes are that long.
    ray_slots: u32,
    // Step size as a share of that of the other weights.
    share: f32,
    // Gains and offsets stay within +- these.
    limits: vec2<f32>,
    // Decay of both moments.
    decays: vec2<f32>,
    // Added to the root of the second.
    epsilon: f32,
    // First row of the slopes in their array.
    row: u32,
}
