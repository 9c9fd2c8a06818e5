// alive: finds after a round which rays of a picture continue, and how many.
//
// Source    a ray ends where less than OPAQUE passes, or at its last step.
// Twin      marf_field::render::Tile::finish, equal.
// Threads   one per ray: workgroup 64, folded.
// Reads     `walk`. `state` [6][ray slots], row 5: transmittance of the ray. `next_step` [rays].
// Writes    `done` [rays]: 1 where a ray has ended, never back to 0. `counts`[COUNT_ALIVE], which scan.wgsl sets to 0,
//           by adding.
// Extremes  The transmittance is never NaN: the kernels before cut it and mark the fault. A missing ray ends with the
//           first round.
@group(0) @binding(0) var<uniform> walk: Walk;
@group(0) @binding(1) var<storage, read> state: array<f32>;
@group(0) @binding(2) var<storage, read> next_step: array<u32>;
@group(0) @binding(3) var<storage, read_write> done: array<u32>;
@group(0) @binding(4) var<storage, read_write> counts: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let ray = flat(id, groups);
    if ray >= walk.rays { return; }
    let goes_on = state[5u * walk.ray_slots + ray] >= OPAQUE && next_step[ray] < walk.padded;
    if goes_on { atomicAdd(&counts[COUNT_ALIVE], 1u); } else { done[ray] = 1u; }
}
