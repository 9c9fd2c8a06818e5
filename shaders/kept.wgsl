// kept: writes the number of the visited sample of every kept sample.
//
// Source    none.
// Twin      marf_field::shade::Shade::choose (its list `kept`), equal.
// Threads   LANES per ray: workgroup 64, folded.
// Reads     `spans` [4][rays]: first sample and number of visited samples, then of kept ones. `counts`[slot] rays in
//           use. `shown`, from 2 rays on [capacity]: numbers of the kept visited samples, the first of every ray.
// Writes    `origin` u32 [capacity]: number of the visited sample, for samples of rays in use, each once.
// Extremes  a ray without samples writes nothing. Samples beyond the capacity are not written.
@group(0) @binding(0) var<uniform> extent: Extent;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> spans: array<u32>;
@group(0) @binding(3) var<storage, read> shown: array<u32>;
@group(0) @binding(4) var<storage, read_write> origin: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let thread = flat(id, groups);
    let ray = thread / LANES;
    if ray >= extent.rays || ray >= counts[extent.slot] { return; }
    let first = spans[2u * extent.rays + ray];
    let end = min(first + spans[3u * extent.rays + ray], extent.capacity);
    let from_row = 2u * extent.rays + spans[ray] - first;
    for (var sample = first + thread % LANES; sample < end; sample += LANES) { origin[sample] = shown[from_row + sample]; }
}
