// harmonics: spherical harmonics of the direction a sample is seen from, or of every ray.
//
// Source    the 16 real functions of degree 0 to 3, in the form instant-ngp uses.
// Twin      marf_field::sh::harmonics; within 1e-6: a driver may fuse products and sums.
// Threads   one per sample (`main`) or ray (`of_rays`): workgroup 64, folded.
// Reads     directions [rays] (w is 0 where there is no ray), counts[slot] in use; `main` also ray_of [stride]
// Writes    values, rows first .. first + 16 of columns of `stride` numbers, those in use, each element once
// Extremes  a ray that is not there gets 16 zeros, whatever its direction.
struct HarmonicsRun {
    slot: u32,
    stride: u32,
    first: u32,
    pad0: u32,
}
@group(0) @binding(0) var<uniform> run: HarmonicsRun;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> directions: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> values: array<f32>;
@group(0) @binding(4) var<storage, read> ray_of: array<u32>;

fn put(index: u32, ray: u32) {
    let direction = directions[ray];
    let there = direction.w > 0.0;
    let found = harmonics_of(direction.xyz);
    var at = run.first * run.stride + index;
    values[at] = select(0.0, found[0], there);
    values[at + run.stride] = select(0.0, found[1], there);
    values[at + 2u * run.stride] = select(0.0, found[2], there);
    values[at + 3u * run.stride] = select(0.0, found[3], there);
    values[at + 4u * run.stride] = select(0.0, found[4], there);
    values[at + 5u * run.stride] = select(0.0, found[5], there);
    values[at + 6u * run.stride] = select(0.0, found[6], there);
    values[at + 7u * run.stride] = select(0.0, found[7], there);
    at += 8u * run.stride;
    values[at] = select(0.0, found[8], there);
    values[at + run.stride] = select(0.0, found[9], there);
    values[at + 2u * run.stride] = select(0.0, found[10], there);
    values[at + 3u * run.stride] = select(0.0, found[11], there);
    values[at + 4u * run.stride] = select(0.0, found[12], there);
    values[at + 5u * run.stride] = select(0.0, found[13], there);
    values[at + 6u * run.stride] = select(0.0, found[14], there);
    values[at + 7u * run.stride] = select(0.0, found[15], there);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let sample = flat(id, groups);
    if sample >= counts[run.slot] { return; }
    put(sample, ray_of[sample]);
}

@compute @workgroup_size(64)
fn of_rays(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let ray = flat(id, groups);
    if ray >= counts[run.slot] { return; }
    put(ray, ray);
}
