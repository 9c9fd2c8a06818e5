// density_sum: partial sums of the densities of probed cells.
//
// Source    none: a sum in a fixed tree.
// Twin      the mean in marf_field::occupancy::Occupancy::update, there in f64, within 1e-6 relative.
// Threads   64 a partial sum, each EACH cells 64 apart: workgroup 64, folded over x and y.
// Reads     `density` [cells].
// Writes    `tallies` [parts], each exactly once.
// Extremes  cells never probed (unknown and more) and those no camera sees (below 0) do not count.
@group(0) @binding(0) var<uniform> filling: Filling;
@group(0) @binding(1) var<storage, read> density: array<f32>;
@group(0) @binding(2) var<storage, read_write> tallies: array<Tally>;

var<workgroup> sums: array<f32, 64>;
var<workgroup> counts: array<u32, 64>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let number = group.x + group.y * groups.x;
    var sum = 0.0;
    var count = 0u;
    for (var k = 0u; k < EACH; k++) {
        let cell = (number * EACH + k) * 64u + lane;
        if cell < filling.cells {
            let value = density[cell];
            if value >= 0.0 && value < filling.unknown {
                sum += value;
                count += 1u;
            }
        }
    }
    sums[lane] = sum;
    counts[lane] = count;
    for (var half = 32u; half > 0u; half >>= 1u) {
        workgroupBarrier();
        if lane < half {
            sums[lane] += sums[lane + half];
            counts[lane] += counts[lane + half];
        }
    }
    if lane == 0u && number < filling.parts {
        tallies[number] = Tally(sums[0], counts[0]);
    }
}
