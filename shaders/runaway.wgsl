// runaway: finds numbers that run away in the rows of an array.
//
// Source    none.
// Twin      marf_field::cpu::composite::Runaways; equal.
// Threads   one per (4 samples, row): workgroup 64 x 1, dispatch (capacity / 256, rows).
// Reads     values [rows][capacity], counts[slot] samples in use
// Writes    faults[fault] where a number runs away; nothing else
// Extremes  NaN and infinite numbers run away. Samples beyond those in use are not looked at.
struct RunawayRun {
    slot: u32,
    capacity: u32,
    fault: u32,
    pad0: u32,
}
@group(0) @binding(0) var<uniform> run: RunawayRun;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> values: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> faults: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let first = 4u * id.x;
    let in_use = counts[run.slot];
    if first >= in_use { return; }
    let value = values[id.y * (run.capacity / 4u) + id.x];
    let is_wild = runs_away(value.x)
        || (first + 1u < in_use && runs_away(value.y))
        || (first + 2u < in_use && runs_away(value.z))
        || (first + 3u < in_use && runs_away(value.w));
    if is_wild { atomicMax(&faults[run.fault], 1u); }
}
