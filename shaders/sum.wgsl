// sum: adds the parts of the gradients of networks and background, in an order that no thread decides.
//
// Source    none.
// Twin      the function `summed` of the tests in gpu/nets_tests.rs, equal to the bit.
// Threads   16 weights x 16 slices a workgroup of 256, the weights next to each other. One workgroup for every 16
//           weights, folded over x and y. Slice s adds parts s, s + 16, s + 32, ... in this order. Then slices s and s
//           + 8 are added, s and s + 4, s and s + 2, s and s + 1.
// Reads     `parts`: the first `weights` numbers of [groups][stride] by `back`, and, from number `first` on, [rays /
//           64][64] by `compare`. The counts of kept samples and of rays show which parts hold something.
// Writes    `gradient` [weights + 64], each element once, of the background only where run.behind is 1.
//           `faults`[FAULT_NETWORKS] and `faults`[FAULT_BACKGROUND] where a sum runs away.
// Extremes  no sample gives 0. NaN and infinite parts give such a sum, which is found by its bits.
struct SumRun {
    // Weights of the networks.
    weights: u32,
    // Numbers of a group.
    stride: u32,
    // Groups of samples.
    groups: u32,
    // Samples of a tile.
    samples: u32,
    // First number of the background's parts.
    first: u32,
    // 1 where the background is learnt.
    behind: u32,
    pad0: u32,
    pad1: u32,
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
    let is_net = weight < run.weights;
    let is_used = is_net || (run.behind == 1u && weight < run.weights + 64u);
    let tiles = (counts[COUNT_KEPT] + run.samples - 1u) / run.samples;
    var count = select((counts[COUNT_RAYS] + 63u) / 64u, min(tiles, run.groups), is_net);
    var at = select(run.first + weight - run.weights, weight, is_net);
    let stride = select(64u, run.stride, is_net);
    if !is_used { count = 0u; }
    var sum = 0.0;
    for (var part = local / 16u; part < count; part += 16u) { sum += parts[at + part * stride]; }
    sums[local] = sum;
    for (var half = 128u; half >= 16u; half /= 2u) {
        workgroupBarrier();
        if local < half { sums[local] += sums[local + half]; }
    }
    // The remaining numbers are the first 16, each of the thread that added it last.
    if local >= 16u || !is_used { return; }
    gradient[weight] = sums[local];
    if runs_away(sums[local]) { atomicMax(&faults[select(FAULT_BACKGROUND, FAULT_NETWORKS, is_net)], 1u); }
}
