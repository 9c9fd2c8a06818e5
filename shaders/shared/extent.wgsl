// Sizes of columns.
struct Extent {
    // Place in `counts` of what is in use.
    slot: u32,
    // Numbers a column of samples.
    capacity: u32,
    // Numbers a column of rays.
    rays: u32,
    pad0: u32,
}
