// scan: from samples of every ray to where they begin, for as many rays as fit, in their order.
//
// Source    exclusive prefix sum in integers: every workgroup sums the amounts in front of it, then Hillis and Steele
//           1986 over its own rays. The reads of the first sum do not wait for each other, and no workgroup waits for
//           another.
// Twin      marf_field::gpu::scan_tests, a running sum, equal.
// Threads   one per ray: workgroup 256, folded.
// Reads     `walk`. `amounts` [rays]: samples of every ray. `counts`[COUNT_RAYS] rays in use where walk.again is 1.
// Writes    `spans` [2][ray slots] of the rays in use. `counts`[slot] samples. Where walk.again is 0: `xyz`, `along`,
//           `ray_of` between the number of samples and the next multiple of 16 become 0, `counts`[COUNT_RAYS] rays that
//           fit, `counts`[COUNT_ALIVE] 0.
// Extremes  The first ray whose samples do not fit, and every ray behind it, is CLIPPED with count 0: its first sample
//           is 0xffffffff and counts[COUNT_RAYS] <= its number. 0 rays: both counts are 0. Sums beyond 2^32 - 1 stay
//           there.
@group(0) @binding(0) var<uniform> walk: Walk;
@group(0) @binding(1) var<storage, read> amounts: array<u32>;
@group(0) @binding(2) var<storage, read_write> spans: array<u32>;
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;
@group(0) @binding(4) var<storage, read_write> xyz: array<f32>;
@group(0) @binding(5) var<storage, read_write> along: array<f32>;
@group(0) @binding(6) var<storage, read_write> ray_of: array<u32>;

const THREADS: u32 = 256u;
const BLOCK: u32 = 16u;

var<workgroup> sums: array<u32, THREADS>;

// a + b, at most 2^32 - 1.
fn cut_sum(a: u32, b: u32) -> u32 {
    let sum = a + b;
    return select(sum, 0xffffffffu, sum < a);
}

// Sum of all amounts in front of a ray, the same for all threads of a workgroup.
fn sum_before(ray: u32, me: u32) -> u32 {
    var sum = 0u;
    for (var other = me; other < ray; other += THREADS) { sum = cut_sum(sum, amounts[other]); }
    sums[me] = sum;
    for (var half = THREADS / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if me < half { sums[me] = cut_sum(sums[me], sums[me + half]); }
    }
    workgroupBarrier();
    let all = sums[0];
    workgroupBarrier();
    return all;
}

// Sum of the numbers of all threads up to this one.
fn sum_up_to(me: u32, number: u32) -> u32 {
    sums[me] = number;
    for (var apart = 1u; apart < THREADS; apart *= 2u) {
        workgroupBarrier();
        var other = 0u;
        if me >= apart { other = sums[me - apart]; }
        workgroupBarrier();
        sums[me] = cut_sum(sums[me], other);
    }
    return sums[me];
}

fn clear(sample: u32) {
    for (var column = 0u; column < 3u; column++) {
        xyz[column * walk.capacity + sample] = 0.0;
        along[column * walk.capacity + sample] = 0.0;
    }
    ray_of[sample] = 0u;
}

// Writes the totals at the last ray that fits: `rays` rays with `samples` samples.
fn tell(rays: u32, samples: u32) {
    counts[walk.slot] = samples;
    if walk.again == 1u { return; }
    counts[COUNT_RAYS] = rays;
    counts[COUNT_ALIVE] = 0u;
    let end = min((samples + BLOCK - 1u) / BLOCK * BLOCK, walk.capacity);
    for (var sample = samples; sample < end; sample++) { clear(sample); }
}

@compute @workgroup_size(256)
fn main(
    @builtin(local_invocation_index) me: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    var rays = walk.rays;
    if walk.again == 1u { rays = min(rays, counts[COUNT_RAYS]); }
    let first = (group.x + group.y * groups.x) * THREADS;
    if first > 0u && first >= walk.rays { return; }
    let ray = first + me;
    let before = sum_before(select(0u, first, first < rays), me);
    var amount = 0u;
    if ray < rays { amount = amounts[ray]; }
    let end = cut_sum(before, sum_up_to(me, amount));
    if ray >= rays {
        if ray == 0u { tell(0u, 0u); }
        return;
    }
    if end > walk.capacity {
        spans[ray] = CLIPPED;
        spans[walk.ray_slots + ray] = 0u;
        if ray == 0u { tell(0u, 0u); }
        return;
    }
    spans[ray] = end - amount;
    spans[walk.ray_slots + ray] = amount;
    var is_last = ray + 1u == rays;
    if !is_last { is_last = cut_sum(end, amounts[ray + 1u]) > walk.capacity; }
    if is_last { tell(ray + 1u, end); }
}
