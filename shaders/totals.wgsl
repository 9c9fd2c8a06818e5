// totals: counts, faults and loss of a step, for the host.
//
// Source    none.
// Twin      marf_field::trainer::Trainer::step (its sums). The loss is within 1e-5: f32 here, f64 there.
// Threads   one workgroup of 256, dispatch (1).
// Reads     `loss` f32 [rays] of rays in use (row FOUND_LOSS of `compare`), `counts` [4], `faults` [FAULT_SLOTS].
//           `pace.total`.
// Writes    `ring`[pace.total], modulo its length: one element.
// Extremes  no ray: the loss is 0. NaN is passed on, its fault is set already.
struct Total {
    visited: u32,
    kept: u32,
    rays: u32,
    alive: u32,
    faults: u32,
    loss: f32,
    pad0: u32,
    pad1: u32,
}
@group(0) @binding(0) var<uniform> extent: Extent;
@group(0) @binding(1) var<uniform> pace: Pace;
@group(0) @binding(2) var<storage, read> counts: array<u32>;
@group(0) @binding(3) var<storage, read> faults: array<u32>;
@group(0) @binding(4) var<storage, read> loss: array<f32>;
@group(0) @binding(5) var<storage, read_write> ring: array<Total>;

var<workgroup> sums: array<f32, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32) {
    let in_use = min(counts[extent.slot], extent.rays);
    var sum = 0.0;
    for (var ray = lane; ray < in_use; ray += 256u) { sum += loss[ray]; }
    sums[lane] = sum;
    for (var half = 128u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half { sums[lane] += sums[lane + half]; }
    }
    if lane > 0u { return; }
    var mask = 0u;
    for (var kind = 0u; kind < FAULT_SLOTS; kind++) { mask |= select(0u, 1u, faults[kind] > 0u) << kind; }
    let place = pace.total % arrayLength(&ring);
    ring[place] = Total(
        counts[COUNT_VISITED], counts[COUNT_KEPT], counts[COUNT_RAYS], counts[COUNT_ALIVE], mask, sums[0], 0u, 0u
    );
}
