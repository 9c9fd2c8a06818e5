// thresholds: the densities from which on a cell counts as occupied.
//
// Source    instant-ngp, arXiv 2201.05989, appendix on occupancy grids: a visible density, or the mean if less.
// Twin      marf_field::occupancy::Occupancy::update, `least` and `refill`, within 1e-6 relative.
// Threads   64 in one workgroup, each sums every 64th tally, then a fixed tree.
// Reads     `tallies` [parts].
// Writes    `least` [2]: for occupied cells, for empty ones.
// Extremes  no density probed: the mean is 0 and every seen cell is occupied.
@group(0) @binding(0) var<uniform> filling: Filling;
@group(0) @binding(1) var<storage, read> tallies: array<Tally>;
@group(0) @binding(2) var<storage, read_write> least: array<f32>;

var<workgroup> sums: array<f32, 64>;
var<workgroup> counts: array<u32, 64>;

@compute @workgroup_size(64)
fn main(@builtin(local_invocation_index) lane: u32) {
    var sum = 0.0;
    var count = 0u;
    for (var number = lane; number < filling.parts; number += 64u) {
        sum += tallies[number].sum;
        count += tallies[number].count;
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
    if lane == 0u {
        let mean = sums[0] / f32(max(counts[0], 1u));
        let lesser = select(mean, filling.shows, filling.shows < mean);
        least[0] = lesser;
        least[1] = select(filling.shows, lesser, filling.at_mean == 1u);
    }
}
