// compare: what a ray gathers, its colour beside the pixel, and the slopes of the loss in colour, background, exposure.
//
// Source    NeRF, arXiv 2003.08934, eq. 3; loss is the squared error of gain * colour + offset, a mean over rays in
//           use and channels.
// Twin      marf_field::batch::Losses::ray (gather, behind, compare); within 1e-6.
// Threads   one per ray, its samples from the front: workgroup 64, folded.
// Reads     spans [4][rays] (of visited samples, of kept ones: the first of the visited), light [3][capacity] (alpha, transmittance) of visited samples,
//           rgb [3][capacity] of kept ones, directions [rays] (w 0: no
//           ray), targets u32 [rays] (bits of the pixel; w: the view), gains [views] log gains and, where run.offsets is 1,
//           [views] offsets behind them, background [3][16], counts[slot] rays in use
// Writes    found [FOUND_ROWS][rays] of rays in use, each element once, but row 3 never: rows 0 to 2 slopes in the
//           background's logits (row 3 stays 0 and makes a multiple of 4), FOUND_GAIN 3 in log gains, FOUND_OFFSET 3 in
//           offsets, FOUND_LOSS sum of squares, FOUND_SLOPE 3 in the ray's colour, FOUND_TOWARDS slope times colour
//           behind; faults of FAULT_LOSS where a loss, FAULT_BACKGROUND where a coefficient of the background,
//           FAULT_EXPOSURES where an exposure or its slope runs away
// Extremes  an empty ray shows the background. A ray that is not there gets zeros and no fault.
struct CompareRun {
    slot: u32,
    capacity: u32,
    rays: u32,
    views: u32,
    offsets: u32,
    behind: u32,
    pad0: u32,
    pad1: u32,
}
@group(0) @binding(0) var<uniform> run: CompareRun;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> spans: array<u32>;
@group(0) @binding(3) var<storage, read> light: array<f32>;
@group(0) @binding(4) var<storage, read> rgb: array<f32>;
@group(0) @binding(5) var<storage, read> directions: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> targets: array<vec4<u32>>;
@group(0) @binding(7) var<storage, read> gains: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read> background: array<f32>;
@group(0) @binding(9) var<storage, read_write> found: array<f32>;
@group(0) @binding(10) var<storage, read_write> faults: array<atomic<u32>>;

// Colour, and what passes behind the last sample.
fn gathered(ray: u32) -> vec4<f32> {
    let first = spans[2u * run.rays + ray];
    let end = first + spans[3u * run.rays + ray];
    let shift = spans[ray] - first;
    var sum = vec3<f32>(0.0);
    var left = 1.0;
    for (var sample = first; sample < end; sample++) {
        let transmittance = light[2u * run.capacity + shift + sample];
        let weight = transmittance * light[run.capacity + shift + sample];
        let shade = vec3<f32>(rgb[sample], rgb[run.capacity + sample], rgb[2u * run.capacity + sample]);
        sum = fma(vec3<f32>(weight), shade, sum);
        left = transmittance - weight;
    }
    return vec4<f32>(sum, left);
}

fn put(row: u32, ray: u32, value: vec3<f32>) {
    let at = row * run.rays + ray;
    found[at] = value.x;
    found[at + run.rays] = value.y;
    found[at + 2u * run.rays] = value.z;
}

fn any_runs_away(value: vec3<f32>) -> bool {
    return runs_away(value.x) || runs_away(value.y) || runs_away(value.z);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let ray = flat(id, groups);
    if ray >= run.rays { return; }
    if run.behind == 1u && ray < 48u && runs_away(background[ray]) { atomicMax(&faults[FAULT_BACKGROUND], 1u); }
    if ray >= counts[run.slot] { return; }
    let direction = directions[ray];
    if !(direction.w > 0.0) {
        put(0u, ray, vec3<f32>(0.0));
        put(FOUND_GAIN, ray, vec3<f32>(0.0));
        put(FOUND_OFFSET, ray, vec3<f32>(0.0));
        put(FOUND_SLOPE, ray, vec3<f32>(0.0));
        found[FOUND_LOSS * run.rays + ray] = 0.0;
        found[FOUND_TOWARDS * run.rays + ray] = 0.0;
        return;
    }
    let sum = gathered(ray);
    let logits = logits_behind(harmonics_of(direction.xyz));
    let is_seen = run.behind == 1u;
    let behind = select(vec3<f32>(0.0), colours_of(logits), is_seen);
    let plain = fma(vec3<f32>(sum.w), behind, sum.xyz);

    // Integers: as f32 the view would be a denormal, which a driver may flush to 0.
    let target_of = targets[ray];
    let pixel = bitcast<vec3<f32>>(target_of.xyz);
    let view = target_of.w;
    let log_gain = gains[view].xyz;
    var offset = vec3<f32>(0.0);
    if run.offsets == 1u { offset = gains[run.views + view].xyz; }
    let gain = vec3<f32>(exp_own(log_gain.x), exp_own(log_gain.y), exp_own(log_gain.z));

    let scale = 2.0 / f32(3u * counts[run.slot]);
    let error = fma(plain, gain, offset - pixel);
    let squares = error * error;
    let slope = scale * error * gain;
    let loss = squares.x + squares.y + squares.z;
    put(FOUND_GAIN, ray, slope * plain);
    put(FOUND_OFFSET, ray, scale * error);
    put(FOUND_SLOPE, ray, slope);
    found[FOUND_LOSS * run.rays + ray] = loss;
    found[FOUND_TOWARDS * run.rays + ray] = dot_own(slope, behind);
    let inner = vec3<f32>(
        colour_slope(logits.x, behind.x), colour_slope(logits.y, behind.y), colour_slope(logits.z, behind.z)
    );
    put(0u, ray, select(vec3<f32>(0.0), sum.w * slope * inner, is_seen));
    if runs_away(loss) { atomicMax(&faults[FAULT_LOSS], 1u); }
    if any_runs_away(log_gain) || any_runs_away(offset) || any_runs_away(slope * plain)
        || any_runs_away(scale * error) { atomicMax(&faults[FAULT_EXPOSURES], 1u); }
}
