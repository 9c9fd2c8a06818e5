// What changes with every step of training.
struct Step {
    // 64 bits each, low first.
    seed: vec2<u32>,
    number: vec2<u32>,
    // Kept pixels of all photos.
    pixels: u32,
    // Pixels that see a sparse point. 0 where none pulls, or no longer.
    observations: u32,
    // One ray in this many goes to an observation.
    share: u32,
    // Rays wanted.
    rays: u32,
    views: u32,
    // Weight of a pull.
    pull: f32,
    // Step size of the optimiser.
    rate: f32,
    pad0: u32,
}
