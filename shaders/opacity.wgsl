// opacity: raw densities to optical depths, opacities and transmittances along every ray; counts what shows.
//
// Source    NeRF, arXiv 2003.08934, eq. 3, in log space: T_i = exp(-sum of tau before i).
// Twin      marf_field::shade::Shade::opacities and drop_hidden; within 1e-6.
// Threads   one per ray, its samples from the front: workgroup 64, folded.
// Reads     spans [2][rays], density [.][capacity] (row 0, the raw density), along [3][capacity] (row 1, the length),
//           before [rays] (optical depth in front of the first sample), counts[slot] rays in use
// Writes    light [3][capacity]: tau, alpha, transmittance of the samples of rays in use, each element once;
//           shown u32 [2][rays]: samples in front of the first with a transmittance below OPAQUE, and the bits of the
//           sum of all tau; both 0 for rays not in use. faults[FAULT_DENSITY] where a raw density runs away
// Extremes  raw densities are cut at RAW_LIMIT; NaN counts as the limit and is a fault. A length of 0 has tau 0 and
//           alpha 0. An empty ray shows 0 samples.
@group(0) @binding(0) var<uniform> extent: Extent;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> spans: array<u32>;
@group(0) @binding(3) var<storage, read> density: array<f32>;
@group(0) @binding(4) var<storage, read> along: array<f32>;
@group(0) @binding(5) var<storage, read> before: array<f32>;
@group(0) @binding(6) var<storage, read_write> light: array<f32>;
@group(0) @binding(7) var<storage, read_write> shown: array<u32>;
@group(0) @binding(8) var<storage, read_write> faults: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let ray = flat(id, groups);
    if ray >= extent.rays { return; }
    var visible = 0u;
    var total = 0.0;
    if ray < counts[extent.slot] {
        let first = spans[ray];
        let end = first + spans[extent.rays + ray];
        var depth = before[ray];
        var goes_on = true;
        var is_wild = false;
        for (var sample = first; sample < end; sample++) {
            let raw = density[sample];
            is_wild = is_wild || runs_away(raw);
            let cut = select(RAW_LIMIT, raw, raw < RAW_LIMIT);
            let tau = exp_own(cut + RAW_SHIFT) * along[extent.capacity + sample];
            let transmittance = exp_own(-depth);
            light[sample] = tau;
            light[extent.capacity + sample] = one_minus_exp_neg(tau);
            light[2u * extent.capacity + sample] = transmittance;
            goes_on = goes_on && transmittance >= OPAQUE;
            visible += select(0u, 1u, goes_on);
            depth += tau;
            total += tau;
        }
        if is_wild { atomicMax(&faults[FAULT_DENSITY], 1u); }
    }
    shown[ray] = visible;
    shown[extent.rays + ray] = bitcast<u32>(total);
}
