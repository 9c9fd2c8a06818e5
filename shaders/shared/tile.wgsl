// Layers of networks over a tile of samples that stays in workgroup memory; workgroups of THREADS.
// Needs of the head: FOURS, groups of 4 samples of a tile. The kernel declares `run`, a NetsRun, and `weights`.

// All layers: the density network's, then the colour network's.
struct NetsRun {
    // Numbers a column of samples.
    capacity: u32,
    // Layers of the density network.
    density: u32,
    // Layers of both.
    layers: u32,
    // Weights of both.
    weights: u32,
    // 1 where the colour network sees the direction.
    directed: u32,
    // Numbers of a workgroup in `work`.
    stride: u32,
    // Workgroups among which the tiles are dealt out.
    groups: u32,
    pad0: u32,
    // Of every layer: inputs, outputs, first weight, first row of its input in the workgroup's own memory.
    shapes: array<vec4<u32>, 8>,
}

const THREADS: u32 = 128u;

// [neuron][FOURS], 16 KB: the widest layer fits.
var<workgroup> tile: array<vec4<f32>, 1024>;

// One vector of 4 samples for each of 8 neurons.
alias Sums = array<vec4<f32>, 8>;

// What runs a thread: 4 samples of 8 neurons, which are its own from layer to layer.
fn four_of(me: u32) -> u32 { return me % FOURS; }
fn eight_of(me: u32) -> u32 { return me / FOURS; }

// Negative numbers become 0. By their bits: a driver may make a comparison with 0 a maximum, which eats NaN.
fn relu(x: vec4<f32>) -> vec4<f32> {
    let bits = bitcast<vec4<u32>>(x);
    return select(x, vec4<f32>(0.0), bits - vec4(0x80000001u) < vec4(0x7f800000u));
}

// Outputs 8 eight .. 8 eight + 8 of a layer: a chain of fused multiply-adds in the order of its inputs.
fn ahead(layer: vec4<u32>, four: u32, eight: u32) -> Sums {
    var s0 = vec4<f32>(0.0);
    var s1 = s0;
    var s2 = s0;
    var s3 = s0;
    var s4 = s0;
    var s5 = s0;
    var s6 = s0;
    var s7 = s0;
    var at = four;
    var weight = layer.z / 4u + 2u * eight;
    for (var k = 0u; k < layer.x; k++) {
        let x = tile[at];
        let low = weights[weight];
        let high = weights[weight + 1u];
        s0 = fma(x, vec4<f32>(low.x), s0);
        s1 = fma(x, vec4<f32>(low.y), s1);
        s2 = fma(x, vec4<f32>(low.z), s2);
        s3 = fma(x, vec4<f32>(low.w), s3);
        s4 = fma(x, vec4<f32>(high.x), s4);
        s5 = fma(x, vec4<f32>(high.y), s5);
        s6 = fma(x, vec4<f32>(high.z), s6);
        s7 = fma(x, vec4<f32>(high.w), s7);
        at += FOURS;
        weight += layer.y / 4u;
    }
    return Sums(s0, s1, s2, s3, s4, s5, s6, s7);
}

fn rectified(s: Sums) -> Sums {
    return Sums(relu(s[0]), relu(s[1]), relu(s[2]), relu(s[3]), relu(s[4]), relu(s[5]), relu(s[6]), relu(s[7]));
}

// Puts neurons 8 eight .. 8 eight + 8 of 4 samples into the tile.
fn put(four: u32, eight: u32, s: Sums) {
    let at = 8u * eight * FOURS + four;
    tile[at] = s[0];
    tile[at + FOURS] = s[1];
    tile[at + 2u * FOURS] = s[2];
    tile[at + 3u * FOURS] = s[3];
    tile[at + 4u * FOURS] = s[4];
    tile[at + 5u * FOURS] = s[5];
    tile[at + 6u * FOURS] = s[6];
    tile[at + 7u * FOURS] = s[7];
}

// Runs the tile through a layer, ReLU behind it where `is_hidden`. Every thread of the workgroup calls it.
fn advance(layer: vec4<u32>, me: u32, is_hidden: bool) {
    let is_busy = eight_of(me) < layer.y / 8u;
    var sums: Sums;
    if is_busy {
        sums = ahead(layer, four_of(me), eight_of(me));
        if is_hidden { sums = rectified(sums); }
    }
    workgroupBarrier();
    if is_busy { put(four_of(me), eight_of(me), sums); }
    workgroupBarrier();
}
