// march: walks along rays through occupied cells of the contracted box. `count` counts samples, `write` writes them.
//
// Source    instant-ngp, arXiv 2201.05989, appendix E. Contraction of mip-NeRF 360, arXiv 2111.12077, eq. 10, in the
//           maximum norm. Steps are counted, t never adds up: no ray stalls where t + dt = t.
// Twin      marf_field::cpu::march::March, same blocks of 16 steps, limit and order. Equal within 1e-6 of the box, 1e-6
//           of t. A sample within rounding of a cell's border may fall on its other side.
// Threads   LANES per ray, each a run of neighbouring blocks, so that no thread has more than 1 / LANES of a ray's
//           steps: workgroup 64, folded.
// Reads     `walk`. `origins`, `directions` [rays] vec4. `steps` [padded] (begin, length). `bits` [side^3 / 32].
//           `next_step` [rays]. `count` reads `done` [rays]. `write` reads `spans` [2][rays] of scan.wgsl and, from 4
//           rays on, the output `before` of `count`.
// Writes    `count` writes `amounts` [rays] and `before` [rays][LANES], samples of a ray in front of each lane's run.
//           `write` writes `places` [6][capacity], x, y, z, then t, delta, place in the ray's steps, and `ray_of`
//           [capacity]: the samples of every span each once. It writes `next_step` where walk.resumes is 1.
// Extremes  directions.w = 0 or done: no samples, and the next step is the last. A span that is CLIPPED is skipped: its
//           ray continues from where it was. 1e6 half sides away a ray keeps to the border of the box. NaN is in cell
//           0, as on the CPU. In `write` no lane leaves its share of a span: samples that it does not find there are at
//           the origin, length 0.
@group(0) @binding(0) var<uniform> walk: Walk;
@group(0) @binding(1) var<storage, read> origins: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> directions: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> steps: array<vec2<f32>>;
@group(0) @binding(4) var<storage, read> bits: array<u32>;
@group(0) @binding(5) var<storage, read_write> next_step: array<u32>;
@group(0) @binding(6) var<storage, read> done: array<u32>;
@group(0) @binding(7) var<storage, read_write> amounts: array<u32>;
@group(0) @binding(8) var<storage, read_write> before: array<u32>;
@group(0) @binding(6) var<storage, read> spans: array<u32>;
@group(0) @binding(7) var<storage, read_write> places: array<f32>;
@group(0) @binding(8) var<storage, read_write> ray_of: array<u32>;

// Steps of a block. A ray pauses only between two.
const BLOCK: u32 = 16u;

// Samples of the lanes of the workgroup's rays.
var<workgroup> sums: array<u32, 64>;

// The point in the unit box, and by how much a length shrinks there.
fn contracted(p: vec3<f32>) -> vec4<f32> {
    let size = abs(p);
    let pair = select(size.x, size.y, size.y > size.x);
    let m = select(pair, size.z, size.z > pair);
    let outside = m > 1.0;
    let shrink = select(1.0, 1.0 / m, outside);
    let scale = select(1.0, (2.0 - shrink) * shrink, outside);
    return vec4(fma(p * scale, vec3(0.25), vec3(0.5)), shrink);
}

// Cut to [0, 1]. NaN becomes 0.
fn unit(x: vec3<f32>) -> vec3<f32> {
    let above = select(vec3(0.0), x, x > vec3(0.0));
    return select(vec3(1.0), above, above < vec3(1.0));
}

fn occupied(at: vec3<f32>) -> bool {
    let corner = min(vec3<u32>(unit(at) * f32(walk.side)), vec3(walk.side - 1u));
    let cell = (corner.z * walk.side + corner.y) * walk.side + corner.x;
    return ((bits[cell >> 5u] >> (cell & 31u)) & 1u) == 1u;
}

fn distance_at(step: u32, jitter: f32) -> f32 {
    return fma(jitter, steps[step].y, steps[step].x);
}

fn point_at(origin: vec4<f32>, direction: vec4<f32>, t: f32) -> vec4<f32> {
    return contracted(fma(direction.xyz, vec3(t), origin.xyz));
}

fn first_step(ray: u32) -> u32 {
    if walk.resumes == 0u { return 0u; }
    return next_step[ray];
}

fn is_over(ray: u32) -> bool {
    if directions[ray].w == 0.0 { return true; }
    if walk.resumes == 0u { return false; }
    return done[ray] != 0u;
}

// The steps of a lane, of those of a ray from `first` on: begin and end, multiples of BLOCK.
fn run_of(first: u32, lane: u32) -> vec2<u32> {
    let blocks = (walk.padded - first) / BLOCK;
    let each = (blocks + LANES - 1u) / LANES * BLOCK;
    return min(vec2(first) + vec2(lane, lane + 1u) * each, vec2(walk.padded));
}

// Samples in front of the end of a run, `found` in front of its begin. At most as many blocks as it takes to
// reach `limit`.
fn counted(ray: u32, run: vec2<u32>, found: u32, limit: u32) -> u32 {
    let origin = origins[ray];
    let direction = directions[ray];
    var sum = found;
    var step = run.x;
    while step < run.y && sum < limit {
        for (let end = step + BLOCK; step < end; step++) {
            let point = point_at(origin, direction, distance_at(step, origin.w));
            if step < walk.steps && occupied(point.xyz) { sum++; }
        }
    }
    return sum;
}

@compute @workgroup_size(64)
fn count(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) me: u32,
) {
    let at = flat(id, groups);
    let ray = at / LANES;
    let lane = at % LANES;
    var run = vec2<u32>(0u);
    if ray < walk.rays { run = run_of(select(first_step(ray), walk.padded, is_over(ray)), lane); }
    let own = counted(ray, run, 0u, 0xffffffffu);
    sums[me] = own;
    workgroupBarrier();
    if ray >= walk.rays { return; }
    var ahead = 0u;
    for (var other = me - lane; other < me; other++) { ahead += sums[other]; }
    before[at] = ahead;
    // One lane knows how many samples the ray has: that in which the limit is reached, else the last.
    if ahead >= walk.limit { return; }
    if ahead + own >= walk.limit {
        amounts[ray] = counted(ray, run, ahead, walk.limit);
    } else if lane == LANES - 1u {
        amounts[ray] = ahead + own;
    }
}

fn store(ray: u32, sample: u32, at: vec3<f32>, along_it: vec3<f32>) {
    let columns = sample + vec3(0u, 1u, 2u) * walk.capacity;
    let behind = columns + vec3(3u * walk.capacity);
    places[columns.x] = at.x;
    places[columns.y] = at.y;
    places[columns.z] = at.z;
    places[behind.x] = along_it.x;
    places[behind.y] = along_it.y;
    places[behind.z] = along_it.z;
    ray_of[sample] = ray;
}

// Writes the samples of a run, `found` in front of it, to `sample` on, none from `end` on, and returns the
// step to continue from.
fn written(ray: u32, run: vec2<u32>, found: u32, share: vec2<u32>) -> u32 {
    let origin = origins[ray];
    let direction = directions[ray];
    var sum = found;
    var sample = share.x;
    var step = run.x;
    while step < run.y && sum < walk.limit {
        for (let last = step + BLOCK; step < last; step++) {
            let t = distance_at(step, origin.w);
            let point = point_at(origin, direction, t);
            if step >= walk.steps || !occupied(point.xyz) { continue; }
            sum++;
            if sample >= share.y { continue; }
            let place = (f32(step) + origin.w) / f32(walk.steps);
            store(ray, sample, point.xyz, vec3(t, steps[step].y * point.w, place));
            sample++;
        }
    }
    for (; sample < share.y; sample++) { store(ray, sample, vec3(0.0), vec3(0.0)); }
    return step;
}

@compute @workgroup_size(64)
fn write(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let at = flat(id, groups);
    let ray = at / LANES;
    let lane = at % LANES;
    if ray >= walk.rays || spans[ray] == CLIPPED { return; }
    let begin = spans[ray];
    let amount = spans[walk.ray_slots + ray];
    let counts_at = 4u * walk.ray_slots + at;
    let found = spans[counts_at];
    if found >= walk.limit { return; }
    let is_last = lane == LANES - 1u;
    var until = amount;
    if !is_last { until = spans[counts_at + 1u]; }
    // A ray that is over, or finds nothing to its end, has nothing to write.
    let run = run_of(select(first_step(ray), walk.padded, amount == 0u), lane);
    let step = written(ray, run, found, vec2(begin + found, begin + min(until, amount)));
    // As `count` has it: that lane pauses in which the limit was reached, and no ray stays where it was.
    if walk.resumes == 1u && (is_last || until >= walk.limit) { next_step[ray] = step; }
}
