// opacity: raw densities to optical depths, opacities and transmittances along every ray. It also chooses the kept
// samples.
//
// Source    NeRF, arXiv 2003.08934, eq. 3, in log space: T_i = exp(-sum of tau before i). Systematic sampling by
//           weight: Madow 1949. The length of a sample kept with share p is divided by p.
// Twin      marf_field::shade::Shade::opacities and choose, within 1e-6.
// Threads   one in APART per ray, its samples from the front: workgroup 64, folded.
// Reads     `spans` [2][rays]. `density` [.][capacity] (row 0, the raw density), `along` [3][capacity] (row 1, the
//           length). `before` [rays] (optical depth in front of the first sample). `counts`[slot] rays in use.
// Writes    `light` [3][capacity] of the samples of rays in use: tau, alpha, transmittance. tau is 0 where the raw
//           density is at its limit: the slope in it is tau times that in tau. Where extent.most is not 0, the kept
//           samples of every ray come first, and `along` moves with them. `shown` u32 [2][rays]: number of kept
//           samples, none behind a transmittance below OPAQUE, and the bits of the sum of all tau. Both are 0 for rays
//           not in use. `shown` then has [capacity] numbers of the kept visited samples, the first of every ray.
//           `faults`[FAULT_DENSITY] where a raw density runs away.
// Extremes  raw densities are cut at RAW_LIMIT. NaN counts as the limit and is a fault. A length of 0 has tau 0 and
//           alpha 0. An empty ray shows 0 samples.
@group(0) @binding(0) var<uniform> extent: Extent;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> spans: array<u32>;
@group(0) @binding(3) var<storage, read> density: array<f32>;
@group(0) @binding(4) var<storage, read_write> along: array<f32>;
@group(0) @binding(5) var<storage, read> before: array<f32>;
@group(0) @binding(6) var<storage, read_write> light: array<f32>;
@group(0) @binding(7) var<storage, read_write> shown: array<u32>;
@group(0) @binding(8) var<storage, read_write> faults: array<atomic<u32>>;

// Optical depth of a length.
fn tau_of(raw: f32, length: f32) -> f32 {
    let cut = select(RAW_LIMIT, raw, raw < RAW_LIMIT);
    return exp_own(cut + RAW_SHIFT) * length;
}

// Sets the light of a sample whose raw density is that of the visited sample `origin`.
fn put(sample: u32, origin: u32, tau: f32, transmittance: f32) {
    light[sample] = select(0.0, tau, density[origin] < RAW_LIMIT);
    light[extent.capacity + sample] = one_minus_exp_neg(tau);
    light[2u * extent.capacity + sample] = transmittance;
    shown[2u * extent.rays + sample] = origin;
}

// A number in [0, 1) that nothing on the ray follows, from the bits of the distance of its first sample.
fn draw(t: f32) -> f32 {
    var bits = bitcast<u32>(t);
    bits = (bits ^ (bits >> 16u)) * 0x7feb352du;
    bits = (bits ^ (bits >> 15u)) * 0x846ca68bu;
    return f32((bits ^ (bits >> 16u)) >> 8u) * 0.000000059604644775390625;
}

// Chooses among the first `visible` samples of a ray by weight, moves the kept ones to its front and returns
// their number.
fn thin(ray: u32, visible: u32) -> u32 {
    let first = spans[ray];
    let most = f32(extent.most);
    let even = EVEN / f32(max(visible, 1u));
    var kept = first;
    var depth = before[ray];
    var sum = draw(along[first]);
    for (var sample = first; sample < first + visible; sample++) {
        let weight = light[2u * extent.capacity + sample] * light[extent.capacity + sample];
        let share = min(most * (weight + even), 1.0);
        let next = sum + share;
        if floor(next) > floor(sum) {
            let length = along[extent.capacity + sample] / share;
            along[kept] = along[sample];
            along[extent.capacity + kept] = length;
            along[2u * extent.capacity + kept] = along[2u * extent.capacity + sample];
            let tau = tau_of(density[sample], length);
            put(kept, sample, tau, exp_own(-depth));
            depth += tau;
            kept++;
        }
        sum = next;
    }
    return kept - first;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let thread = flat(id, groups);
    let ray = thread / APART;
    if thread % APART != 0u || ray >= extent.rays { return; }
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
            let tau = tau_of(raw, along[extent.capacity + sample]);
            let transmittance = exp_own(-depth);
            put(sample, sample, tau, transmittance);
            goes_on = goes_on && transmittance >= OPAQUE;
            visible += select(0u, 1u, goes_on);
            depth += tau;
            total += tau;
        }
        if is_wild { atomicMax(&faults[FAULT_DENSITY], 1u); }
        if extent.most > 0u { visible = thin(ray, visible); }
    }
    shown[ray] = visible;
    shown[extent.rays + ray] = bitcast<u32>(total);
}
