// compare: the colour of a ray against its pixel, the slopes of the loss in colour and exposure, and the gradient of
// the background. The last is in a part for every 64 rays: slope of a logit times harmonic, summed over the rays.
//
// Source    NeRF, arXiv 2003.08934, eq. 3. The loss is the squared error of gain * colour + offset, a mean over rays in
//           use and channels. `sum` adds the parts in an order of its own, so that no thread decides a rounding.
// Twin      marf_field::batch::Losses::ray (gather, behind, compare), within 1e-6.
// Threads   one per ray, its samples from the front: workgroup 64, folded. Then one a coefficient of the background.
// Reads     `spans` [4][rays] (of visited samples, of kept ones: the first of the visited). `light` [3][capacity]
//           (alpha, transmittance) of visited samples, `rgb` [3][capacity] of kept ones. `directions` [rays] (w 0: no
//           ray), `targets` [rays]. `gains` [views] log gains and, where run.offsets is 1, [views] offsets behind them.
//           `background` [3][16], `counts`[slot] rays in use.
// Writes    `found` [FOUND_ROWS][rays] of rays in use, each element once. FOUND_GAIN: 3 slopes in log gains.
//           FOUND_OFFSET: 3 in offsets. FOUND_LOSS: sum of squares. FOUND_SLOPE: 3 in the ray's colour. FOUND_TOWARDS:
//           slope times colour behind. Where run.behind is 1, `parts` [rays / 64][4][16] of workgroups that hold rays
//           in use, each element once, row 3 being 0. `faults`: FAULT_LOSS where a loss runs away, FAULT_BACKGROUND
//           where a coefficient of the background does, FAULT_EXPOSURES where an exposure or its slope does.
// Extremes  an empty ray shows the background. A ray of a photo with transparency has a colour of its own behind it,
//           and teaches the background nothing. A missing ray gets zeros and no fault, and adds 0 to its part.
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
@group(0) @binding(6) var<storage, read> targets: array<Target>;
@group(0) @binding(7) var<storage, read> gains: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read> background: array<f32>;
@group(0) @binding(9) var<storage, read_write> found: array<f32>;
@group(0) @binding(10) var<storage, read_write> faults: array<atomic<u32>>;
@group(0) @binding(11) var<storage, read_write> parts: array<f32>;

// [harmonic][ray] and [channel][ray] of the workgroup's rays.
var<workgroup> seen: array<f32, 1024>;
var<workgroup> slopes: array<f32, 192>;

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

// Results of a missing ray.
fn clear(ray: u32) {
    put(FOUND_GAIN, ray, vec3<f32>(0.0));
    put(FOUND_OFFSET, ray, vec3<f32>(0.0));
    put(FOUND_SLOPE, ray, vec3<f32>(0.0));
    found[FOUND_LOSS * run.rays + ray] = 0.0;
    found[FOUND_TOWARDS * run.rays + ray] = 0.0;
}

// Compares a ray and returns the slopes in the background's logits.
fn compared(ray: u32, harmonics: array<f32, 16>) -> vec3<f32> {
    let sum = gathered(ray);
    let logits = logits_behind(harmonics);
    let aim = targets[ray];
    let has_own = aim.share >= 0.0;
    let is_seen = run.behind == 1u && !has_own;
    let behind = select(select(vec3<f32>(0.0), colours_of(logits), is_seen), aim.behind, has_own);
    // Over black, as the pixel is: the transmittance, less the share of the same colour that the pixel shows.
    let passes = sum.w - select(0.0, aim.share, has_own);
    let plain = fma(vec3<f32>(passes), behind, sum.xyz);

    let pixel = aim.rgb;
    let view = aim.view;
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
    if runs_away(loss) { atomicMax(&faults[FAULT_LOSS], 1u); }
    if any_runs_away(log_gain) || any_runs_away(offset) || any_runs_away(slope * plain)
        || any_runs_away(scale * error) { atomicMax(&faults[FAULT_EXPOSURES], 1u); }
    return select(vec3<f32>(0.0), sum.w * slope * inner, is_seen);
}

// Adds up the part of the workgroup's rays: a coefficient a thread, in the order of the rays.
fn learn_behind(me: u32, at: array<f32, 16>, slope: vec3<f32>) -> f32 {
    var harmonics = at;
    for (var index = 0u; index < 16u; index++) { seen[64u * index + me] = harmonics[index]; }
    slopes[me] = slope.x;
    slopes[64u + me] = slope.y;
    slopes[128u + me] = slope.z;
    workgroupBarrier();
    var sum = 0.0;
    if me < 48u {
        for (var other = 0u; other < 64u; other++) {
            sum = fma(slopes[me / 16u * 64u + other], seen[me % 16u * 64u + other], sum);
        }
    }
    return sum;
}

@compute @workgroup_size(64)
fn main(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) me: u32,
) {
    let ray = flat(id, groups);
    let in_use = min(counts[run.slot], run.rays);
    if run.behind == 1u && ray < 48u && runs_away(background[ray]) { atomicMax(&faults[FAULT_BACKGROUND], 1u); }
    var direction = vec4<f32>(0.0);
    if ray < in_use { direction = directions[ray]; }
    var harmonics = array<f32, 16>();
    var slope = vec3<f32>(0.0);
    if direction.w > 0.0 {
        harmonics = harmonics_of(direction.xyz);
        slope = compared(ray, harmonics);
    } else if ray < in_use {
        clear(ray);
    }
    // Uniform for all threads: no thread has left before.
    if run.behind == 1u {
        let sum = learn_behind(me, harmonics, slope);
        if ray - me < in_use { parts[ray] = sum; }
    }
}
