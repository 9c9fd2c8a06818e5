// copy: one array to another: the highest rate of memory, a reference for other kernels in a bench.
//
// Source    none.
// Twin      a copy (gpu/ceilings.rs), equal to the bit: numbers go as integers.
// Threads   one per 4 numbers: workgroup 64, folded over x and y.
// Reads     `source` [n / 4] of vec4.
// Writes    `copied` [n / 4] of vec4, each element exactly once.
// Extremes  none.
@group(0) @binding(0) var<storage, read> source: array<vec4<u32>>;
@group(0) @binding(1) var<storage, read_write> copied: array<vec4<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let at = flat(id, groups);
    if at >= arrayLength(&copied) {
        return;
    }
    copied[at] = source[at];
}
