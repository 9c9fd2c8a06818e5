// sum: adds the parts of a gradient, in an order that no thread decides.
//
// Source    none.
// Twin      the function `summed` of the tests in gpu/nets_tests.rs; equal to the bit.
// Threads   16 weights x 16 slices a workgroup of 256, the weights next to each other; one workgroup for every 16
//           weights, folded over x and y. Slice s adds chunks s, s + 16, s + 32, ... in this order; then slices s and
//           s + 8 are added, s and s + 4, s and s + 2, s and s + 1.
// Reads     parts [chunks][weights], counts[slot] samples in use: they tell which chunks hold something
// Writes    gradient [weights], each element once; faults[fault] where a sum runs away
// Extremes  no sample gives 0. NaN and infinite parts give such a sum, which is found by its bits.
struct SumRun {
    weights: u32,
    slot: u32,
    chunk: u32,
    fault: u32,
}
@group(0) @binding(0) var<uniform> run: SumRun;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> parts: array<f32>;
@group(0) @binding(3) var<storage, read_write> gradient: array<f32>;
@group(0) @binding(4) var<storage, read_write> faults: array<atomic<u32>>;

// Sums of slices: of weight w the sum of slice s is number 16 s + w.
var<workgroup> sums: array<f32, 256>;

@compute @workgroup_size(256)
fn main(
    @builtin(local_invocation_index) local: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let weight = (group.x + group.y * groups.x) * 16u + local % 16u;
    let is_used = weight < run.weights;
    let chunks = select(0u, (counts[run.slot] + run.chunk - 1u) / run.chunk, is_used);
    var sum = 0.0;
    for (var chunk = local / 16u; chunk < chunks; chunk += 16u) {
        sum += parts[chunk * run.weights + weight];
    }
    sums[local] = sum;
    for (var half = 128u; half >= 16u; half /= 2u) {
        workgroupBarrier();
        if local < half { sums[local] += sums[local + half]; }
    }
    // What is left are the first 16 numbers, each of the thread that added it last.
    if local >= 16u || !is_used { return; }
    gradient[weight] = sums[local];
    if runs_away(sums[local]) { atomicMax(&faults[run.fault], 1u); }
}
