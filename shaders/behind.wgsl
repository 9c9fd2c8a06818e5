// behind: gradient of the background, a part for every 64 rays: slope of a logit times harmonic, summed over the rays.
//
// Source    none; parts that `sum` adds in an order of its own, so that no thread decides a rounding.
// Twin      marf_field::losses (the gradient of the background); within 1e-6 of the sum of the sizes of the terms.
// Threads   one workgroup of 64 for 64 rays, folded; then a thread a coefficient.
// Reads     directions [rays] (w 0: no ray), found rows 0 to 2 of [FOUND_ROWS][rays], counts[slot] rays in use
// Writes    parts [rays / 64][4][16] from number `first` on, of workgroups that hold rays, each element once
// Extremes  rays not in use, and those that are not there, count as 0. Row 3 is 0.
struct BehindRun {
    slot: u32,
    rays: u32,
    first: u32,
    pad0: u32,
}
@group(0) @binding(0) var<uniform> run: BehindRun;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> directions: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> found: array<f32>;
@group(0) @binding(4) var<storage, read_write> parts: array<f32>;

// [harmonic or channel][ray]
var<workgroup> seen: array<f32, 1024>;
var<workgroup> slopes: array<f32, 192>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) me: u32,
) {
    let chunk = group.x + group.y * groups.x;
    let ray = 64u * chunk + me;
    let in_use = min(counts[run.slot], run.rays);
    if 64u * chunk >= in_use { return; }
    let is_there = ray < in_use && directions[min(ray, run.rays - 1u)].w > 0.0;
    var harmonics = array<f32, 16>();
    if is_there { harmonics = harmonics_of(directions[ray].xyz); }
    for (var index = 0u; index < 16u; index++) { seen[64u * index + me] = harmonics[index]; }
    for (var channel = 0u; channel < 3u; channel++) {
        var slope = 0.0;
        if is_there { slope = found[channel * run.rays + ray]; }
        slopes[64u * channel + me] = slope;
    }
    workgroupBarrier();
    var sum = 0.0;
    if me < 48u {
        for (var other = 0u; other < 64u; other++) {
            sum = fma(slopes[me / 16u * 64u + other], seen[me % 16u * 64u + other], sum);
        }
    }
    parts[run.first + 64u * chunk + me] = sum;
}
