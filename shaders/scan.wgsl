// scan: from samples of every ray to where they begin; as many rays as fit, in their order.
//
// Source    exclusive prefix sum in integers: Hillis and Steele 1986 over 256 runs of neighbouring rays
// Twin      marf_field::gpu::scan_tests, a running sum; equal
// Threads   one workgroup of 256, each a run of rays; 16 of them also clear what fills up the last block of samples
// Reads     walk; amounts [rays]: samples of every ray; counts[COUNT_RAYS] rays in use where walk.again is 1
// Writes    spans [2][ray slots] of the rays in use; counts[slot] samples; xyz, along, ray_of between the number of
//           samples and the next multiple of 16: 0, where walk.again is 0; there also counts[COUNT_RAYS] rays that fit, counts[COUNT_ALIVE] 0
// Extremes  The first ray whose samples do not fit, and every ray behind it, is CLIPPED with count 0: its first sample
//           is 0xffffffff and counts[COUNT_RAYS] <= its number. 0 rays: both counts are 0. Sums beyond 2^32 - 1 stay there.
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
var<workgroup> fitting: atomic<u32>;
var<workgroup> samples: atomic<u32>;

// a + b, at most 2^32 - 1.
fn cut_sum(a: u32, b: u32) -> u32 {
    let sum = a + b;
    return select(sum, 0xffffffffu, sum < a);
}

// Sum of all runs up to that of this thread, in `sums`.
fn sum_runs(me: u32) {
    for (var apart = 1u; apart < THREADS; apart *= 2u) {
        workgroupBarrier();
        var before = 0u;
        if me >= apart { before = sums[me - apart]; }
        workgroupBarrier();
        sums[me] = cut_sum(sums[me], before);
    }
    workgroupBarrier();
}

fn clear(sample: u32) {
    for (var column = 0u; column < 3u; column++) {
        xyz[column * walk.capacity + sample] = 0.0;
        along[column * walk.capacity + sample] = 0.0;
    }
    ray_of[sample] = 0u;
}

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) me: u32) {
    // What workgroup memory holds before is not relied on; the barriers of sum_runs lie in between.
    if me == 0u {
        atomicStore(&fitting, 0u);
        atomicStore(&samples, 0u);
    }
    var rays = walk.rays;
    if walk.again == 1u { rays = min(rays, counts[COUNT_RAYS]); }
    let run = (rays + THREADS - 1u) / THREADS;
    let first = min(me * run, rays);
    let end = min(first + run, rays);
    var sum = 0u;
    for (var ray = first; ray < end; ray++) { sum = cut_sum(sum, amounts[ray]); }
    sums[me] = sum;
    sum_runs(me);
    var begin = 0u;
    if me > 0u { begin = sums[me - 1u]; }
    var fits = 0u;
    var used = 0u;
    for (var ray = first; ray < end; ray++) {
        let next = cut_sum(begin, amounts[ray]);
        if next <= walk.capacity {
            spans[ray] = begin;
            spans[walk.ray_slots + ray] = amounts[ray];
            fits++;
            used = next;
        } else {
            spans[ray] = CLIPPED;
            spans[walk.ray_slots + ray] = 0u;
        }
        begin = next;
    }
    atomicAdd(&fitting, fits);
    atomicMax(&samples, used);
    workgroupBarrier();
    let total = atomicLoad(&samples);
    if me == 0u {
        counts[walk.slot] = total;
    }
    if me == 0u && walk.again == 0u {
        counts[COUNT_RAYS] = atomicLoad(&fitting);
        counts[COUNT_ALIVE] = 0u;
    }
    let end_of_block = min((total + BLOCK - 1u) / BLOCK * BLOCK, walk.capacity);
    if walk.again == 0u && total + me < end_of_block { clear(total + me); }
}
