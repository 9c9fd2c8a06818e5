// Sizes of columns.
struct Extent {
    // Place in `counts` of what is in use.
    slot: u32,
    // Numbers a column of samples.
    capacity: u32,
    // Numbers a column of rays.
    rays: u32,
    // Samples of a ray that are kept, about. 0: all that show.
    most: u32,
}
