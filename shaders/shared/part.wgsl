// What one dispatch works on: some levels whose tables fit one binding.
struct GridPart {
    // Samples of a column.
    capacity: u32,
    // Place of the number of samples in `counts`.
    slot: u32,
    // The first level. The workgroup's z counts from it.
    level: u32,
    // The first entry that is bound.
    base: u32,
}
