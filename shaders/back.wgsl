// back: both networks back over kept samples, from the slopes of logits and raw density to those of weights and
// features.
//
// Source    reverse mode over a tile at a time. Activations are recomputed, which costs a third more arithmetic and
//           saves every column between the layers.
// Twin      marf_field::cpu::net::Net::backward over both networks, slopes within 1e-5 of the largest. Sums over
//           samples run tile by tile and group by group in the order of `sum`: no thread decides a rounding.
// Threads   `groups` workgroups of 64, folded. Workgroup g takes tiles g, g + groups, ... of 4 FOURS samples each,
//           ROUNDS at most.
// Reads     `features` [inputs][capacity] and `ray_of` [capacity] of visited samples, `origin` [capacity]. `directions`
//           [rays] (w 0: no ray), `weights`. `d_outputs` [4][capacity] (slopes in the logits and in the raw density).
//           `counts`[COUNT_KEPT] samples in use.
// Writes    `work` [groups][stride]: first the gradient of all weights over the group's tiles, of groups that have
//           some. Then memory of the group. `slopes` [inputs][capacity] of tiles that hold samples, each element once.
//           `faults`[FAULT_FEATURES] where a slope of a sample in use runs away.
// Extremes  samples beyond those in use count as 0 whatever their values, NaN too. No sample: nothing is written.
@group(0) @binding(0) var<uniform> run: NetsRun;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> features: array<f32>;
@group(0) @binding(3) var<storage, read> origin: array<u32>;
@group(0) @binding(4) var<storage, read> ray_of: array<u32>;
@group(0) @binding(5) var<storage, read> directions: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> weights: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> d_outputs: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> work: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> slopes: array<vec4<f32>>;
@group(0) @binding(10) var<storage, read_write> faults: array<atomic<u32>>;

fn feature_at(at: u32) -> f32 {
    if at == 0xffffffffu { return 0.0; }
    return features[at];
}

// Numbers of samples in use, 0 for the others.
fn alive(x: vec4<f32>, sample: u32, in_use: u32) -> vec4<f32> {
    return select(vec4(0.0), x, vec4(sample, sample + 1u, sample + 2u, sample + 3u) < vec4(in_use));
}

// Puts neurons 8 eight .. 8 eight + 8 of 8 samples into the tile, and into the workgroup's memory from number `at` on.
fn put_and_keep(at: u32, four: u32, eight: u32, sums: Sums) {
    put(four, eight, sums);
    let to = at + 8u * eight * FOURS + four;
    work[to] = sums[0];
    work[to + HALF] = sums[8];
    work[to + FOURS] = sums[1];
    work[to + FOURS + HALF] = sums[9];
    work[to + 2u * FOURS] = sums[2];
    work[to + 2u * FOURS + HALF] = sums[10];
    work[to + 3u * FOURS] = sums[3];
    work[to + 3u * FOURS + HALF] = sums[11];
    work[to + 4u * FOURS] = sums[4];
    work[to + 4u * FOURS + HALF] = sums[12];
    work[to + 5u * FOURS] = sums[5];
    work[to + 5u * FOURS + HALF] = sums[13];
    work[to + 6u * FOURS] = sums[6];
    work[to + 6u * FOURS + HALF] = sums[14];
    work[to + 7u * FOURS] = sums[7];
    work[to + 7u * FOURS + HALF] = sums[15];
}

// s + a sum over four neurons.
fn four_terms(w: vec4<f32>, d0: vec4<f32>, d1: vec4<f32>, d2: vec4<f32>, d3: vec4<f32>, s: vec4<f32>) -> vec4<f32> {
    return fma(d3, vec4(w.w), fma(d2, vec4(w.z), fma(d1, vec4(w.y), fma(d0, vec4(w.x), s))));
}

// Slopes of inputs 8 eight .. 8 eight + 8 of a layer from those of its first 4 `fours` outputs in the tile, in their order.
fn behind(layer: vec4<u32>, four: u32, eight: u32, fours: u32) -> Sums {
    var s = Sums();
    let row = layer.y / 4u;
    let first = layer.z / 4u + 8u * eight * row;
    for (var k = 0u; k < fours; k++) {
        let at = 4u * k * FOURS + four;
        let d0 = tile[at];
        let d1 = tile[at + FOURS];
        let d2 = tile[at + 2u * FOURS];
        let d3 = tile[at + 3u * FOURS];
        let e0 = tile[at + HALF];
        let e1 = tile[at + FOURS + HALF];
        let e2 = tile[at + 2u * FOURS + HALF];
        let e3 = tile[at + 3u * FOURS + HALF];
        let w0 = weights[first + k];
        s[0] = four_terms(w0, d0, d1, d2, d3, s[0]);
        s[8] = four_terms(w0, e0, e1, e2, e3, s[8]);
        let w1 = weights[first + k + row];
        s[1] = four_terms(w1, d0, d1, d2, d3, s[1]);
        s[9] = four_terms(w1, e0, e1, e2, e3, s[9]);
        let w2 = weights[first + k + 2u * row];
        s[2] = four_terms(w2, d0, d1, d2, d3, s[2]);
        s[10] = four_terms(w2, e0, e1, e2, e3, s[10]);
        let w3 = weights[first + k + 3u * row];
        s[3] = four_terms(w3, d0, d1, d2, d3, s[3]);
        s[11] = four_terms(w3, e0, e1, e2, e3, s[11]);
        let w4 = weights[first + k + 4u * row];
        s[4] = four_terms(w4, d0, d1, d2, d3, s[4]);
        s[12] = four_terms(w4, e0, e1, e2, e3, s[12]);
        let w5 = weights[first + k + 5u * row];
        s[5] = four_terms(w5, d0, d1, d2, d3, s[5]);
        s[13] = four_terms(w5, e0, e1, e2, e3, s[13]);
        let w6 = weights[first + k + 6u * row];
        s[6] = four_terms(w6, d0, d1, d2, d3, s[6]);
        s[14] = four_terms(w6, e0, e1, e2, e3, s[14]);
        let w7 = weights[first + k + 7u * row];
        s[7] = four_terms(w7, d0, d1, d2, d3, s[7]);
        s[15] = four_terms(w7, e0, e1, e2, e3, s[15]);
    }
    return s;
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
        select(none, s[8], work[place + HALF] > none),
        select(none, s[9], work[place + FOURS + HALF] > none),
        select(none, s[10], work[place + 2u * FOURS + HALF] > none),
        select(none, s[11], work[place + 3u * FOURS + HALF] > none),
        select(none, s[12], work[place + 4u * FOURS + HALF] > none),
        select(none, s[13], work[place + 5u * FOURS + HALF] > none),
        select(none, s[14], work[place + 6u * FOURS + HALF] > none),
        select(none, s[15], work[place + 7u * FOURS + HALF] > none),
    );
}

// s + a sum over 4 samples.
fn over(a: vec4<f32>, d: vec4<f32>, s: f32) -> f32 {
    return fma(a.w, d.w, fma(a.z, d.z, fma(a.y, d.y, fma(a.x, d.x, s))));
}

// s + sums over 4 samples, one for each of 4 outputs.
fn over_four(a: vec4<f32>, d: array<vec4<f32>, 4>, s: vec4<f32>) -> vec4<f32> {
    return vec4(over(a, d[0], s.x), over(a, d[1], s.y), over(a, d[2], s.z), over(a, d[3], s.w));
}

// Adds the share of the tile's first 4 `fours` samples of 4 x 8 weights of a layer to those at `to`: inputs
// from row `a` of the workgroup's memory on, slopes of outputs from `d` of the tile on. 12 numbers are read
// for 32 multiply-adds. Neighbours begin `turn` groups of samples apart: their simultaneous reads are then in
// different banks.
fn learn_block(to: u32, width: u32, a: u32, d: u32, fours: u32, turn: u32, is_first: bool) {
    var g = array<vec4<f32>, 8>();
    for (var k = 0u; k < fours; k++) {
        let four = (k + turn) % FOURS;
        let d0 = tile[d + four];
        let d1 = tile[d + FOURS + four];
        let d2 = tile[d + 2u * FOURS + four];
        let d3 = tile[d + 3u * FOURS + four];
        let d4 = tile[d + 4u * FOURS + four];
        let d5 = tile[d + 5u * FOURS + four];
        let d6 = tile[d + 6u * FOURS + four];
        let d7 = tile[d + 7u * FOURS + four];
        let a0 = work[a + four];
        let a1 = work[a + FOURS + four];
        let a2 = work[a + 2u * FOURS + four];
        let a3 = work[a + 3u * FOURS + four];
        let low = array(d0, d1, d2, d3);
        let high = array(d4, d5, d6, d7);
        g[0] = over_four(a0, low, g[0]);
        g[1] = over_four(a0, high, g[1]);
        g[2] = over_four(a1, low, g[2]);
        g[3] = over_four(a1, high, g[3]);
        g[4] = over_four(a2, low, g[4]);
        g[5] = over_four(a2, high, g[5]);
        g[6] = over_four(a3, low, g[6]);
        g[7] = over_four(a3, high, g[7]);
    }
    // The first tile overwrites the numbers of an earlier step.
    if !is_first {
        g[0] += work[to];
        g[1] += work[to + 1u];
        g[2] += work[to + width];
        g[3] += work[to + width + 1u];
        g[4] += work[to + 2u * width];
        g[5] += work[to + 2u * width + 1u];
        g[6] += work[to + 3u * width];
        g[7] += work[to + 3u * width + 1u];
    }
    work[to] = g[0];
    work[to + 1u] = g[1];
    work[to + width] = g[2];
    work[to + width + 1u] = g[3];
    work[to + 2u * width] = g[4];
    work[to + 2u * width + 1u] = g[5];
    work[to + 3u * width] = g[6];
    work[to + 3u * width + 1u] = g[7];
}

// Adds the tile's share of the weights of a layer, whose slopes of outputs the tile holds. A block is the same thread's from tile
// to tile.
fn learn(own: u32, memory: u32, number: u32, me: u32, is_first: bool) {
    let layer = run.shapes[number];
    let across = layer.y / 8u;
    let width = layer.y / 4u;
    for (var block = me; block < layer.x / 4u * across; block += THREADS) {
        let row = 4u * (block / across);
        let column = 8u * (block % across);
        let to = own + layer.z / 4u + row * width + column / 4u;
        // Only three outputs of the last layer are used: the gradients of the others are 0.
        let fours = select(FOURS, 0u, number + 1u == LAYERS && column > 0u);
        learn_block(to, width, memory + (layer.w + row) * FOURS, column * FOURS, fours, column / 8u, is_first);
    }
}

// Returns whether one of 4 numbers of samples in use runs away.
fn is_wild(slope: vec4<f32>, sample: u32, in_use: u32) -> bool {
    let x = alive(slope, sample, in_use);
    return runs_away(x.x) || runs_away(x.y) || runs_away(x.z) || runs_away(x.w);
}

// Stores slopes of 8 features of 4 samples, and marks those that run away.
fn give(
    at: u32, eight: u32, in_use: u32,
    s0: vec4<f32>, s1: vec4<f32>, s2: vec4<f32>, s3: vec4<f32>, s4: vec4<f32>, s5: vec4<f32>, s6: vec4<f32>, s7: vec4<f32>,
) {
    let column = run.capacity / 4u;
    let to = 8u * eight * column + at;
    slopes[to] = s0;
    slopes[to + column] = s1;
    slopes[to + 2u * column] = s2;
    slopes[to + 3u * column] = s3;
    slopes[to + 4u * column] = s4;
    slopes[to + 5u * column] = s5;
    slopes[to + 6u * column] = s6;
    slopes[to + 7u * column] = s7;
    let first = 4u * at;
    let low = is_wild(s0, first, in_use) || is_wild(s1, first, in_use) || is_wild(s2, first, in_use) || is_wild(s3, first, in_use);
    let high = is_wild(s4, first, in_use) || is_wild(s5, first, in_use) || is_wild(s6, first, in_use) || is_wild(s7, first, in_use);
    if low || high { atomicMax(&faults[FAULT_FEATURES], 1u); }
}

// Rows 16 to 31 of the tile and of the colour network's input: harmonics of 4 samples.
fn recall_harmonics(memory: u32, first: u32, in_use: u32, me: u32) {
    let to = memory + run.shapes[DENSITY].w * FOURS;
    bring_harmonics(first, in_use, me);
    workgroupBarrier();
    for (var at = me; at < 16u * FOURS; at += THREADS) { work[to + 16u * FOURS + at] = tile[16u * FOURS + at]; }
}

// Forward through a layer that is not the last.
fn recall_layer(memory: u32, number: u32, first: u32, in_use: u32, me: u32) {
    if number == DENSITY && run.directed == 1u {
        recall_harmonics(memory, first, in_use, me);
        workgroupBarrier();
    }
    let layer = run.shapes[number];
    let is_busy = eight_of(me) < layer.y / 8u;
    var sums: Sums;
    if is_busy {
        sums = ahead(layer, four_of(me), eight_of(me));
        if number + 1u != DENSITY { sums = rectified(sums); }
    }
    workgroupBarrier();
    if is_busy { put_and_keep(memory + run.shapes[number + 1u].w * FOURS, four_of(me), eight_of(me), sums); }
    workgroupBarrier();
}

// Forward: the inputs of all layers, each kept.
fn recall(memory: u32, first: u32, in_use: u32, me: u32) {
    for (var at = me; at < run.shapes[0].x * FOURS; at += THREADS) {
        let places = bring_column(at / FOURS, 4u * (first + at % FOURS), in_use);
        let x = vec4(feature_at(places.x), feature_at(places.y), feature_at(places.z), feature_at(places.w));
        tile[at] = x;
        work[memory + at] = x;
    }
    workgroupBarrier();
    if LAYERS > 1u { recall_layer(memory, 0u, first, in_use, me); }
    if LAYERS > 2u { recall_layer(memory, 1u, first, in_use, me); }
    if LAYERS > 3u { recall_layer(memory, 2u, first, in_use, me); }
    if LAYERS > 4u { recall_layer(memory, 3u, first, in_use, me); }
    if LAYERS > 5u { recall_layer(memory, 4u, first, in_use, me); }
}

// Slopes in the first 8 outputs of the last layer, those of logits: rows 3 to 7 are 0. The others are not
// read.
fn bring_slopes(first: u32, in_use: u32, me: u32) {
    for (var at = me; at < 8u * FOURS; at += THREADS) {
        let sample = first + at % FOURS;
        var slope = vec4<f32>(0.0);
        if at < 3u * FOURS { slope = alive(d_outputs[at / FOURS * (run.capacity / 4u) + sample], 4u * sample, in_use); }
        tile[at] = slope;
    }
}

// Slopes of compositing in 4 raw densities.
fn raw_slopes(at: u32, in_use: u32) -> vec4<f32> {
    return alive(d_outputs[3u * (run.capacity / 4u) + at], 4u * at, in_use);
}

// Back through one layer: the tile holds the slopes of its outputs, then those of its inputs.
fn retreat(own: u32, number: u32, first: u32, in_use: u32, me: u32, is_first: bool) {
    let memory = own + run.weights / 4u;
    learn(own, memory, number, me, is_first);
    let layer = run.shapes[number];
    let four = four_of(me);
    let eight = eight_of(me);
    // The colour network sees directions, too, whose slopes are not used.
    let wanted = select(layer.x, 16u, number == DENSITY);
    let is_busy = eight < wanted / 8u;
    var sums: Sums;
    if is_busy {
        // Three slopes of the last layer are not 0.
        sums = behind(layer, four, eight, select(layer.y / 4u, 1u, number + 1u == LAYERS));
        if number == DENSITY {
            // Compositing has its own slope in the raw density, output 0 of the density network.
            if eight == 0u {
                sums[0] += raw_slopes(first + four, in_use);
                sums[8] += raw_slopes(first + four + HALF, in_use);
            }
        } else if number > 0u {
            sums = gated(sums, memory + (layer.w + 8u * eight) * FOURS + four);
        } else {
            give(first + four, eight, in_use, sums[0], sums[1], sums[2], sums[3], sums[4], sums[5], sums[6], sums[7]);
            give(first + four + HALF, eight, in_use, sums[8], sums[9], sums[10], sums[11], sums[12], sums[13], sums[14], sums[15]);
        }
    }
    workgroupBarrier();
    if is_busy && number > 0u { put(four, eight, sums); }
    workgroupBarrier();
}

// Forward and back with a tile, whose share is added to the gradient of all weights at `own`.
fn learn_tile(own: u32, first: u32, in_use: u32, me: u32, is_first: bool) {
    let memory = own + run.weights / 4u;
    recall(memory, first, in_use, me);
    bring_slopes(first, in_use, me);
    workgroupBarrier();
    storageBarrier();
    if LAYERS > 5u { retreat(own, 5u, first, in_use, me, is_first); }
    if LAYERS > 4u { retreat(own, 4u, first, in_use, me, is_first); }
    if LAYERS > 3u { retreat(own, 3u, first, in_use, me, is_first); }
    if LAYERS > 2u { retreat(own, 2u, first, in_use, me, is_first); }
    if LAYERS > 1u { retreat(own, 1u, first, in_use, me, is_first); }
    retreat(own, 0u, first, in_use, me, is_first);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) me: u32,
) {
    let number = group.x + group.y * groups.x;
    let in_use = min(counts[COUNT_KEPT], run.capacity);
    let own = number * (run.stride / 4u);
    if number >= run.groups { return; }
    // A loop only where there are tiles for it: see tile.wgsl.
    if ROUNDS == 1u {
        if 4u * number * FOURS < in_use { learn_tile(own, number * FOURS, in_use, me, true); }
    } else {
        for (var first = number * FOURS; 4u * first < in_use; first += run.groups * FOURS) {
            learn_tile(own, first, in_use, me, first == number * FOURS);
        }
    }
}
