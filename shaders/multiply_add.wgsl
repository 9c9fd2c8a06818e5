// multiply_add: chains of x = factor x + addend in registers: the highest rate of arithmetic of a device.
//
// Source    none.
// Twin      the same chains (gpu/ceilings.rs), equal within 1e-6 of their size where fma is not fused.
// Threads   one per 16 chains: workgroup 64, folded over x and y.
// Reads     `run`: links of a chain in fours, factor, addend.
// Writes    `sums` [threads] of vec4, each element exactly once: the sum of the thread's four vectors of chains, which
//           begin at thread / threads + 0, 1, 2, 3 quarters.
// Extremes  0 rounds: the sum of the beginnings.
struct Chains {
    rounds: u32,
    factor: f32,
    addend: f32,
    pad0: u32,
}
@group(0) @binding(0) var<uniform> run: Chains;
@group(0) @binding(1) var<storage, read_write> sums: array<vec4<f32>>;

fn link(x: mat4x4<f32>) -> mat4x4<f32> {
    let factor = vec4<f32>(run.factor);
    let addend = vec4<f32>(run.addend);
    return mat4x4<f32>(
        fma(x[0], factor, addend), fma(x[1], factor, addend), fma(x[2], factor, addend), fma(x[3], factor, addend)
    );
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let thread = flat(id, groups);
    if thread >= arrayLength(&sums) {
        return;
    }
    let begin = vec4<f32>(f32(thread) / f32(arrayLength(&sums)));
    var x = mat4x4<f32>(begin, begin + 0.25, begin + 0.5, begin + 0.75);
    for (var round = 0u; round < run.rounds; round++) {
        x = link(link(link(link(x))));
    }
    sums[thread] = x[0] + x[1] + x[2] + x[3];
}
