// spread: from the slope in a ray's colour to the slopes in raw densities and colour logits.
//
// Source    dL/dtau_i = T_{i+1} q_i - sum of w_j q_j behind i - T_S (g . b), nothing divided by 1 - alpha. With the
//           distortion loss of mip-NeRF 360 (arXiv 2111.12077, eq. 15), the price of opacity and the pull of a point.
// Twin      marf_field::batch::Losses::ray (Ray::spread, emptiness, Pull::spread) and the first half of backward,
//           within 1e-6 of the largest slope of the ray.
// Threads   one in APART per ray, its samples from the front for the sums and then from the back: workgroup 64, folded.
// Reads     `spans` [4][rays] (of visited samples, of kept ones: the first of the visited). `rgb` [3][capacity],
//           `along` [3][capacity] (row 2, the place), `logits` [3][capacity]. `found` [FOUND_ROWS][rays] of `compare`,
//           `pulls` [rays] (place, above 1 for sky, and weight), `counts`[slot] rays in use. `light` and `along` as left by `opacity`.
// Writes    `d_outputs` [4][capacity]: slopes in the three logits and in the raw density of kept samples of rays in
//           use, each element once.
// Extremes  the slope is exactly 0 where the raw density is at its limit (tau is 0 there) or a logit outside its
//           limits. Weight 0 means no pull. Opaque samples (alpha 1) and those with T = 0 give finite slopes.
struct SpreadRun {
    slot: u32,
    capacity: u32,
    rays: u32,
    distortion: f32,
    cell: f32,
    emptiness: f32,
    reach: f32,
    floor: f32,
}
@group(0) @binding(0) var<uniform> run: SpreadRun;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> spans: array<u32>;
@group(0) @binding(3) var<storage, read> rgb: array<f32>;
@group(0) @binding(4) var<storage, read> along: array<f32>;
@group(0) @binding(5) var<storage, read> logits: array<f32>;
@group(0) @binding(6) var<storage, read> found: array<f32>;
@group(0) @binding(7) var<storage, read> pulls: array<vec2<f32>>;
@group(0) @binding(8) var<storage, read> light: array<f32>;
@group(0) @binding(9) var<storage, read_write> d_outputs: array<f32>;

// Opacity, transmittance and place of a visited sample.
fn lit_at(sample: u32) -> vec3<f32> {
    return vec3(light[run.capacity + sample], light[2u * run.capacity + sample], along[2u * run.capacity + sample]);
}

fn row_of(row: u32, ray: u32) -> f32 {
    return found[row * run.rays + ray];
}

fn shade_at(sample: u32) -> vec3<f32> {
    return vec3(rgb[sample], rgb[run.capacity + sample], rgb[2u * run.capacity + sample]);
}

fn logits_at(sample: u32) -> vec3<f32> {
    return vec3(logits[sample], logits[run.capacity + sample], logits[2u * run.capacity + sample]);
}

fn put_logits(sample: u32, slope: vec3<f32>, shade: vec3<f32>, logit: vec3<f32>) {
    let green = run.capacity + sample;
    let blue = run.capacity + green;
    d_outputs[sample] = slope.x * colour_slope(logit.x, shade.x);
    d_outputs[green] = slope.y * colour_slope(logit.y, shade.y);
    d_outputs[blue] = slope.z * colour_slope(logit.z, shade.z);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let thread = flat(id, groups);
    let ray = thread / APART;
    let in_use = counts[run.slot];
    if thread % APART != 0u || ray >= run.rays || ray >= in_use { return; }
    let first = spans[2u * run.rays + ray];
    let end = first + spans[3u * run.rays + ray];
    if first == end { return; }
    let shift = spans[ray] - first;
    let slope = vec3<f32>(row_of(FOUND_SLOPE, ray), row_of(FOUND_SLOPE + 1u, ray), row_of(FOUND_SLOPE + 2u, ray));
    let strength = run.distortion / f32(in_use);
    let emptiness = run.emptiness / f32(in_use);
    let pull = pulls[ray];
    let reach = run.reach * run.cell;

    var total = 0.0;
    var moment = 0.0;
    var near_by = run.floor;
    var left = 1.0;
    // The next sample is read while one is worked on: nothing else hides the latency of a read.
    var next = lit_at(shift + first);
    for (var sample = first; sample < end; sample++) {
        let lit = next;
        next = lit_at(shift + min(sample + 1u, end - 1u));
        let weight = lit.y * lit.x;
        total += weight;
        moment = fma(weight, lit.z, moment);
        near_by += select(0.0, weight, abs(lit.z - pull.x) < reach);
        left = lit.y * (1.0 - lit.x);
    }
    // Sky is behind all steps, whose places are at most 1: what passes all samples counts, and each is in the way.
    let sky = pull.x > 1.0;
    near_by += select(0.0, left, sky);
    // 0 without a pull, where the floor might be 0 too.
    let pulled = pull.y != 0.0;
    let strength_near = select(0.0, select(-pull.y, pull.y, sky) / near_by, pulled);

    var suffix = left * row_of(FOUND_TOWARDS, ray);
    var suffix_near = 0.0;
    var behind = 0.0;
    var behind_moment = 0.0;
    next = lit_at(shift + end - 1u);
    var next_tau = light[shift + end - 1u];
    var next_shade = shade_at(end - 1u);
    var next_logits = logits_at(end - 1u);
    for (var sample = end; sample > first;) {
        sample -= 1u;
        let alpha = next.x;
        let transmittance = next.y;
        let place = next.z;
        let tau = next_tau;
        let shade = next_shade;
        let logit = next_logits;
        let ahead = max(sample, first + 1u) - 1u;
        next = lit_at(shift + ahead);
        next_tau = light[shift + ahead];
        next_shade = shade_at(ahead);
        next_logits = logits_at(ahead);
        let weight = transmittance * alpha;
        let after = transmittance - weight;
        let before = total - behind - weight;
        let before_moment = moment - behind_moment - weight * place;
        let apart = place * (before - behind) - before_moment + behind_moment;
        let spread = strength * (2.0 * apart + weight * run.cell * (2.0f / 3.0f));
        let q = dot_own(slope, shade) + spread;
        var d_tau = after * q - suffix;
        suffix = fma(weight, q, suffix);
        d_tau = fma(emptiness, 1.0 - alpha, d_tau);
        let q_near = select(0.0, strength_near, sky || abs(place - pull.x) < reach);
        d_tau += after * q_near - suffix_near;
        suffix_near = fma(weight, q_near, suffix_near);
        behind += weight;
        behind_moment = fma(weight, place, behind_moment);
        d_outputs[3u * run.capacity + sample] = d_tau * tau;
        put_logits(sample, slope * weight, shade, logit);
    }
}
