// back: both networks back over kept samples, from the slopes of logits and raw density to those of weights and features.
//
// Source    reverse mode over a tile at a time; activations are computed anew, which costs a third more arithmetic and saves
//           every column between the layers.
// Twin      marf_field::cpu::net::Net::backward over both networks; slopes within 1e-5 of the largest. Sums over samples
//           run tile by tile and group by group in the order of `sum`: no thread decides a rounding.
// Threads   `groups` workgroups of 128, folded; workgroup g takes tiles g, g + groups, ... of 4 FOURS samples each.
// Reads     features [inputs][capacity] and ray_of [capacity] of visited samples, origin [capacity], directions [rays] (w 0: no ray),
//           weights, light row 0 of [3][capacity] of visited samples (slope in the raw density), d_logits [3][capacity],
//           counts[COUNT_KEPT] samples in use
// Writes    work [groups][stride]: first the gradient of all weights over the group's tiles, of groups that have some;
//           then memory of the group. slopes [inputs][capacity] of tiles that hold samples, each element once;
//           faults[FAULT_FEATURES] where one of a sample in use runs away
// Extremes  samples beyond those in use count as 0 whatever is there, NaN too. No sample: nothing is written.
@group(0) @binding(0) var<uniform> run: NetsRun;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> features: array<f32>;
@group(0) @binding(3) var<storage, read> origin: array<u32>;
@group(0) @binding(4) var<storage, read> ray_of: array<u32>;
@group(0) @binding(5) var<storage, read> directions: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> weights: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> light: array<f32>;
@group(0) @binding(8) var<storage, read> d_logits: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> work: array<vec4<f32>>;
@group(0) @binding(10) var<storage, read_write> slopes: array<vec4<f32>>;
@group(0) @binding(11) var<storage, read_write> faults: array<atomic<u32>>;

fn feature_at(at: u32) -> f32 {
    if at == 0xffffffffu { return 0.0; }
    return features[at];
}

// Numbers of samples in use, 0 for the others.
fn alive(x: vec4<f32>, sample: u32, in_use: u32) -> vec4<f32> {
    return select(vec4(0.0), x, vec4(sample, sample + 1u, sample + 2u, sample + 3u) < vec4(in_use));
}

// Keeps the tile as the input of a layer.
fn keep(own: u32, layer: vec4<u32>, me: u32) {
    for (var at = me; at < layer.x * FOURS; at += THREADS) { work[own + layer.w * FOURS + at] = tile[at]; }
}

// s + a sum over four neurons.
fn four_terms(w: vec4<f32>, d0: vec4<f32>, d1: vec4<f32>, d2: vec4<f32>, d3: vec4<f32>, s: vec4<f32>) -> vec4<f32> {
    return fma(d3, vec4(w.w), fma(d2, vec4(w.z), fma(d1, vec4(w.y), fma(d0, vec4(w.x), s))));
}

// Slopes of inputs 8 eight .. 8 eight + 8 of a layer from those of its outputs in the tile, in the order of outputs.
fn behind(layer: vec4<u32>, four: u32, eight: u32) -> Sums {
    var s0 = vec4<f32>(0.0);
    var s1 = s0;
    var s2 = s0;
    var s3 = s0;
    var s4 = s0;
    var s5 = s0;
    var s6 = s0;
    var s7 = s0;
    let row = layer.y / 4u;
    let first = layer.z / 4u + 8u * eight * row;
    for (var k = 0u; k < row; k++) {
        let at = 4u * k * FOURS + four;
        let d0 = tile[at];
        let d1 = tile[at + FOURS];
        let d2 = tile[at + 2u * FOURS];
        let d3 = tile[at + 3u * FOURS];
        let w = first + k;
        s0 = four_terms(weights[w], d0, d1, d2, d3, s0);
        s1 = four_terms(weights[w + row], d0, d1, d2, d3, s1);
        s2 = four_terms(weights[w + 2u * row], d0, d1, d2, d3, s2);
        s3 = four_terms(weights[w + 3u * row], d0, d1, d2, d3, s3);
        s4 = four_terms(weights[w + 4u * row], d0, d1, d2, d3, s4);
        s5 = four_terms(weights[w + 5u * row], d0, d1, d2, d3, s5);
        s6 = four_terms(weights[w + 6u * row], d0, d1, d2, d3, s6);
        s7 = four_terms(weights[w + 7u * row], d0, d1, d2, d3, s7);
    }
    return Sums(s0, s1, s2, s3, s4, s5, s6, s7);
}

// 0 where the layer's input is not above 0: the slope of a ReLU.
fn gated(s: Sums, place: u32) -> Sums {
    let none = vec4<f32>(0.0);
    return Sums(
        select(none, s[0], work[place] > none),
        select(none, s[1], work[place + FOURS] > none),
        select(none, s[2], work[place + 2u * FOURS] > none),
        select(none, s[3], work[place + 3u * FOURS] > none),
        select(none, s[4], work[place + 4u * FOURS] > none),
        select(none, s[5], work[place + 5u * FOURS] > none),
        select(none, s[6], work[place + 6u * FOURS] > none),
        select(none, s[7], work[place + 7u * FOURS] > none),
    );
}

// Sum over 4 samples.
fn over(a: vec4<f32>, d: vec4<f32>) -> f32 {
    return fma(a.w, d.w, fma(a.z, d.z, fma(a.y, d.y, a.x * d.x)));
}

fn over_four(a: vec4<f32>, d0: vec4<f32>, d1: vec4<f32>, d2: vec4<f32>, d3: vec4<f32>) -> vec4<f32> {
    return vec4(over(a, d0), over(a, d1), over(a, d2), over(a, d3));
}

// Adds the tile's share of 4 x 4 weights of a layer: inputs from `row` on, slopes of outputs from `column` on.
fn learn_block(own: u32, input: u32, layer: vec4<u32>, row: u32, column: u32, is_first: bool) {
    var g0 = vec4<f32>(0.0);
    var g1 = g0;
    var g2 = g0;
    var g3 = g0;
    let a = input + row * FOURS;
    let d = column * FOURS;
    for (var four = 0u; four < FOURS; four++) {
        let d0 = tile[d + four];
        let d1 = tile[d + FOURS + four];
        let d2 = tile[d + 2u * FOURS + four];
        let d3 = tile[d + 3u * FOURS + four];
        g0 += over_four(work[a + four], d0, d1, d2, d3);
        g1 += over_four(work[a + FOURS + four], d0, d1, d2, d3);
        g2 += over_four(work[a + 2u * FOURS + four], d0, d1, d2, d3);
        g3 += over_four(work[a + 3u * FOURS + four], d0, d1, d2, d3);
    }
    let width = layer.y / 4u;
    let to = own + layer.z / 4u + row * width + column / 4u;
    // The first tile takes the place of what an earlier step left.
    if !is_first {
        g0 += work[to];
        g1 += work[to + width];
        g2 += work[to + 2u * width];
        g3 += work[to + 3u * width];
    }
    work[to] = g0;
    work[to + width] = g1;
    work[to + 2u * width] = g2;
    work[to + 3u * width] = g3;
}

// Adds the tile's share of all weights of a layer. A block is the same thread's from tile to tile.
fn learn(own: u32, input: u32, layer: vec4<u32>, me: u32, is_first: bool) {
    let across = layer.y / 4u;
    for (var block = me; block < layer.x / 4u * across; block += THREADS) {
        learn_block(own, input, layer, 4u * (block / across), 4u * (block % across), is_first);
    }
}

// Stores slopes of features and tells of those that run away.
fn give(four: u32, eight: u32, at: u32, in_use: u32, sums: Sums) {
    var all = sums;
    var is_wild = false;
    for (var row = 0u; row < 8u; row++) {
        slopes[(8u * eight + row) * (run.capacity / 4u) + at] = all[row];
        let x = alive(all[row], 4u * at, in_use);
        is_wild = is_wild || runs_away(x.x) || runs_away(x.y) || runs_away(x.z) || runs_away(x.w);
    }
    if is_wild { atomicMax(&faults[FAULT_FEATURES], 1u); }
}

// Forward: the inputs of all layers, each kept.
fn recall(own: u32, first: u32, in_use: u32, me: u32) {
    for (var at = me; at < run.shapes[0].x * FOURS; at += THREADS) {
        let places = bring_column(at / FOURS, 4u * (first + at % FOURS), in_use);
        tile[at] = vec4(feature_at(places.x), feature_at(places.y), feature_at(places.z), feature_at(places.w));
    }
    workgroupBarrier();
    for (var number = 0u; number + 1u < run.layers; number++) {
        if number == run.density && run.directed == 1u {
            if me < FOURS { bring_harmonics(me, 4u * (first + me), in_use); }
            workgroupBarrier();
        }
        keep(own, run.shapes[number], me);
        advance(run.shapes[number], me, number + 1u != run.density);
    }
    keep(own, run.shapes[run.layers - 1u], me);
    workgroupBarrier();
}

// Slopes of compositing in 4 raw densities.
fn raw_slopes(at: u32, in_use: u32) -> vec4<f32> {
    let places = bring_column(0u, 4u * at, in_use);
    return vec4(raw_slope(places.x), raw_slope(places.y), raw_slope(places.z), raw_slope(places.w));
}

fn raw_slope(at: u32) -> f32 {
    if at == 0xffffffffu { return 0.0; }
    return light[at];
}

// Back through one layer: the tile holds the slopes of its outputs, then those of its inputs.
fn retreat(own: u32, number: u32, first: u32, in_use: u32, me: u32) {
    let layer = run.shapes[number];
    let four = four_of(me);
    let eight = eight_of(me);
    let input = own + layer.w * FOURS;
    // The colour network sees directions, too, whose slopes nobody reads.
    let wanted = select(layer.x, 16u, number == run.density);
    let is_busy = eight < wanted / 8u;
    var sums: Sums;
    if is_busy {
        sums = behind(layer, four, eight);
        if number == run.density {
            // Compositing has its own say on the raw density, output 0 of the density network.
            if eight == 0u { sums[0] += raw_slopes(first + four, in_use); }
        } else if number > 0u {
            sums = gated(sums, input + 8u * eight * FOURS + four);
        } else {
            give(four, eight, first + four, in_use, sums);
        }
    }
    workgroupBarrier();
    if is_busy && number > 0u { put(four, eight, sums); }
    workgroupBarrier();
}

@compute @workgroup_size(128)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) me: u32,
) {
    let number = group.x + group.y * groups.x;
    let in_use = min(counts[COUNT_KEPT], run.capacity);
    let own = number * (run.stride / 4u);
    let memory = own + run.weights / 4u;
    for (var first = number * FOURS; 4u * first < in_use && number < run.groups; first += run.groups * FOURS) {
        recall(memory, first, in_use, me);
        storageBarrier();
        let column = run.capacity / 4u;
        for (var at = me; at < 16u * FOURS; at += THREADS) {
            let sample = first + at % FOURS;
            var slope = vec4<f32>(0.0);
            if at < 3u * FOURS { slope = alive(d_logits[at / FOURS * column + sample], 4u * sample, in_use); }
            tile[at] = slope;
        }
        workgroupBarrier();
        for (var layer = run.layers; layer > 0u;) {
            layer -= 1u;
            let shape = run.shapes[layer];
            learn(own, memory + shape.w * FOURS, shape, me, first == number * FOURS);
            retreat(memory, layer, first, in_use, me);
        }
        storageBarrier();
    }
}
