// gather: copies the kept samples of some rows to the front of others.
//
// Source    none.
// Twin      marf_field::shade::Shade::drop_hidden; equal to the bit: numbers go as integers.
// Threads   one per (sample, row): workgroup 256 x 1, dispatch (capacity / 256, rows).
// Reads     origin u32 [capacity], source rows first_from .. of [.][capacity], counts[slot] samples in use
// Writes    kept, rows first_to .. of [.][capacity], samples in use, each element once; an array of its own
// Extremes  no sample: nothing is written.
struct GatherRun {
    slot: u32,
    capacity: u32,
    first_from: u32,
    first_to: u32,
}
@group(0) @binding(0) var<uniform> run: GatherRun;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> origin: array<u32>;
@group(0) @binding(3) var<storage, read> source: array<u32>;
@group(0) @binding(4) var<storage, read_write> kept: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= counts[run.slot] { return; }
    kept[(run.first_to + id.y) * run.capacity + id.x] = source[(run.first_from + id.y) * run.capacity + origin[id.x]];
}
