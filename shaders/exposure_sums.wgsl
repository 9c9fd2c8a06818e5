// exposure_sums: adds up the slopes of all rays of a photo, in its log gain and its offset.
//
// Source    sum over the rays of a batch, photo by photo.
// Twin      marf_field::learn::learn_exposures, its first loop, within 1e-5 of the sum of sizes: the order differs, and
//           is that of the indices.
// Threads   one workgroup of 64 per view, each thread every 64th ray: dispatch (views folded).
// Reads     `asked`. `counts`[COUNT_RAYS] rays that fit. `targets` [rays]. `slopes` [row + 6][ray slots] from row
//           asked.row on: gain rgb, offset rgb, 0 where a ray has no loss. `gains` [views or 2 views] vec4.
// Writes    `sums` [2][views] vec4, each once. `faults`[FAULT_EXPOSURES] where a slope or a gain runs away.
// Extremes  a view without rays: 0. NaN, infinity or 2^30 and more: the fault, before any weight changes.
@group(0) @binding(0) var<uniform> asked: Exposed;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> targets: array<Target>;
@group(0) @binding(3) var<storage, read> slopes: array<f32>;
@group(0) @binding(4) var<storage, read> gains: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> sums: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> faults: array<atomic<u32>, FAULT_SLOTS>;

const THREADS: u32 = 64u;

var<workgroup> of_gain: array<vec3<f32>, THREADS>;
var<workgroup> of_offset: array<vec3<f32>, THREADS>;

fn is_wild(v: vec3<f32>) -> bool {
    let sizes = bitcast<vec3<u32>>(v) & vec3(0x7fffffffu);
    return any(sizes >= vec3(RUNAWAY));
}

fn slope(row: u32, ray: u32) -> vec3<f32> {
    let at = vec3(row, row + 1u, row + 2u) * asked.ray_slots + ray;
    return vec3(slopes[at.x], slopes[at.y], slopes[at.z]);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) me: u32,
) {
    let view = group.x + group.y * groups.x;
    if view >= asked.views { return; }
    let rays = min(counts[COUNT_RAYS], asked.ray_slots);
    var gain = vec3(0.0);
    var offset = vec3(0.0);
    var wild = false;
    for (var ray = me; ray < rays; ray += THREADS) {
        if targets[ray].view != view { continue; }
        let slope_of_gain = slope(asked.row, ray);
        let slope_of_offset = slope(asked.row + 3u, ray);
        wild = wild || is_wild(slope_of_gain) || is_wild(slope_of_offset);
        gain += slope_of_gain;
        offset += slope_of_offset;
    }
    of_gain[me] = gain;
    of_offset[me] = offset;
    for (var apart = THREADS / 2u; apart > 0u; apart /= 2u) {
        workgroupBarrier();
        if me < apart {
            of_gain[me] += of_gain[me + apart];
            of_offset[me] += of_offset[me + apart];
        }
    }
    if wild { atomicMax(&faults[FAULT_EXPOSURES], 1u); }
    if me > 0u { return; }
    sums[view] = vec4(of_gain[0], 0.0);
    sums[asked.views + view] = vec4(of_offset[0], 0.0);
    let unruly = is_wild(gains[view].xyz) || (asked.offsets == 1u && is_wild(gains[asked.views + view].xyz));
    if unruly { atomicMax(&faults[FAULT_EXPOSURES], 1u); }
}
