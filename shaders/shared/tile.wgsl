// Layers of networks over a tile of samples that stays in workgroup memory, in workgroups of THREADS. The
// head gives FOURS, groups of 4 samples of a tile. It gives LAYERS of both networks, at most 6, and DENSITY:
// the first DENSITY of them, at most 2, are those of the density network. The kernel declares `run`, a
// NetsRun, and `weights`. Layers are written out one by one: a loop around a barrier keeps the registers of a
// software adapter in memory, which takes up to 2.5 times as long.

// All layers: the density network's, then the colour network's.
struct NetsRun {
    // Numbers a column of samples.
    capacity: u32,
    // Weights of both.
    weights: u32,
    // 1 where the colour network sees the direction.
    directed: u32,
    // Numbers of a workgroup in `work`.
    stride: u32,
    // Workgroups among which the tiles are dealt out.
    groups: u32,
    // Outputs of the density network that are read, a multiple of 8.
    latents: u32,
    pad0: u32,
    pad1: u32,
    // Of every layer: inputs, outputs, first weight, first row of its input in the workgroup's own memory.
    shapes: array<vec4<u32>, 6>,
}

const THREADS: u32 = 64u;
// A thread has a group of samples in each half of a tile.
const HALF: u32 = FOURS / 2u;

// [neuron][FOURS], 16 KB: the widest layer fits.
var<workgroup> tile: array<vec4<f32>, 1024>;

// 4 samples for each of 8 neurons, then 4 more, HALF further on. A thread makes 64 multiply-adds of 16
// numbers read. Only constants index it: a card keeps an array that a number indexes in memory, and took 2 to
// 6 times as long.
alias Sums = array<vec4<f32>, 16>;

// Runs a thread: 8 samples of 8 neurons, which are its own from layer to layer.
fn four_of(me: u32) -> u32 { return me % HALF; }
fn eight_of(me: u32) -> u32 { return me / HALF; }

// Negative numbers become 0. By their bits: a driver may make a comparison with 0 a maximum, which eats NaN.
fn relu(x: vec4<f32>) -> vec4<f32> {
    let bits = bitcast<vec4<u32>>(x);
    return select(x, vec4<f32>(0.0), bits - vec4(0x80000001u) < vec4(0x7f800000u));
}

// Outputs 8 eight .. 8 eight + 8 of a layer: a chain of fused multiply-adds in the order of its inputs. The
// inputs of four of these are read first: a card waits once for them.
fn ahead(layer: vec4<u32>, four: u32, eight: u32) -> Sums {
    var s = Sums();
    var at = four;
    let row = layer.y / 4u;
    var weight = layer.z / 4u + 2u * eight;
    for (var k = 0u; k < layer.x; k += 4u) {
        let x0 = tile[at];
        let y0 = tile[at + HALF];
        let low0 = weights[weight];
        let high0 = weights[weight + 1u];
        let x1 = tile[at + FOURS];
        let y1 = tile[at + FOURS + HALF];
        let low1 = weights[weight + row];
        let high1 = weights[weight + row + 1u];
        let x2 = tile[at + 2u * FOURS];
        let y2 = tile[at + 2u * FOURS + HALF];
        let low2 = weights[weight + 2u * row];
        let high2 = weights[weight + 2u * row + 1u];
        let x3 = tile[at + 3u * FOURS];
        let y3 = tile[at + 3u * FOURS + HALF];
        let low3 = weights[weight + 3u * row];
        let high3 = weights[weight + 3u * row + 1u];
        s[0] = fma(x0, vec4<f32>(low0.x), s[0]);
        s[8] = fma(y0, vec4<f32>(low0.x), s[8]);
        s[1] = fma(x0, vec4<f32>(low0.y), s[1]);
        s[9] = fma(y0, vec4<f32>(low0.y), s[9]);
        s[2] = fma(x0, vec4<f32>(low0.z), s[2]);
        s[10] = fma(y0, vec4<f32>(low0.z), s[10]);
        s[3] = fma(x0, vec4<f32>(low0.w), s[3]);
        s[11] = fma(y0, vec4<f32>(low0.w), s[11]);
        s[4] = fma(x0, vec4<f32>(high0.x), s[4]);
        s[12] = fma(y0, vec4<f32>(high0.x), s[12]);
        s[5] = fma(x0, vec4<f32>(high0.y), s[5]);
        s[13] = fma(y0, vec4<f32>(high0.y), s[13]);
        s[6] = fma(x0, vec4<f32>(high0.z), s[6]);
        s[14] = fma(y0, vec4<f32>(high0.z), s[14]);
        s[7] = fma(x0, vec4<f32>(high0.w), s[7]);
        s[15] = fma(y0, vec4<f32>(high0.w), s[15]);
        s[0] = fma(x1, vec4<f32>(low1.x), s[0]);
        s[8] = fma(y1, vec4<f32>(low1.x), s[8]);
        s[1] = fma(x1, vec4<f32>(low1.y), s[1]);
        s[9] = fma(y1, vec4<f32>(low1.y), s[9]);
        s[2] = fma(x1, vec4<f32>(low1.z), s[2]);
        s[10] = fma(y1, vec4<f32>(low1.z), s[10]);
        s[3] = fma(x1, vec4<f32>(low1.w), s[3]);
        s[11] = fma(y1, vec4<f32>(low1.w), s[11]);
        s[4] = fma(x1, vec4<f32>(high1.x), s[4]);
        s[12] = fma(y1, vec4<f32>(high1.x), s[12]);
        s[5] = fma(x1, vec4<f32>(high1.y), s[5]);
        s[13] = fma(y1, vec4<f32>(high1.y), s[13]);
        s[6] = fma(x1, vec4<f32>(high1.z), s[6]);
        s[14] = fma(y1, vec4<f32>(high1.z), s[14]);
        s[7] = fma(x1, vec4<f32>(high1.w), s[7]);
        s[15] = fma(y1, vec4<f32>(high1.w), s[15]);
        s[0] = fma(x2, vec4<f32>(low2.x), s[0]);
        s[8] = fma(y2, vec4<f32>(low2.x), s[8]);
        s[1] = fma(x2, vec4<f32>(low2.y), s[1]);
        s[9] = fma(y2, vec4<f32>(low2.y), s[9]);
        s[2] = fma(x2, vec4<f32>(low2.z), s[2]);
        s[10] = fma(y2, vec4<f32>(low2.z), s[10]);
        s[3] = fma(x2, vec4<f32>(low2.w), s[3]);
        s[11] = fma(y2, vec4<f32>(low2.w), s[11]);
        s[4] = fma(x2, vec4<f32>(high2.x), s[4]);
        s[12] = fma(y2, vec4<f32>(high2.x), s[12]);
        s[5] = fma(x2, vec4<f32>(high2.y), s[5]);
        s[13] = fma(y2, vec4<f32>(high2.y), s[13]);
        s[6] = fma(x2, vec4<f32>(high2.z), s[6]);
        s[14] = fma(y2, vec4<f32>(high2.z), s[14]);
        s[7] = fma(x2, vec4<f32>(high2.w), s[7]);
        s[15] = fma(y2, vec4<f32>(high2.w), s[15]);
        s[0] = fma(x3, vec4<f32>(low3.x), s[0]);
        s[8] = fma(y3, vec4<f32>(low3.x), s[8]);
        s[1] = fma(x3, vec4<f32>(low3.y), s[1]);
        s[9] = fma(y3, vec4<f32>(low3.y), s[9]);
        s[2] = fma(x3, vec4<f32>(low3.z), s[2]);
        s[10] = fma(y3, vec4<f32>(low3.z), s[10]);
        s[3] = fma(x3, vec4<f32>(low3.w), s[3]);
        s[11] = fma(y3, vec4<f32>(low3.w), s[11]);
        s[4] = fma(x3, vec4<f32>(high3.x), s[4]);
        s[12] = fma(y3, vec4<f32>(high3.x), s[12]);
        s[5] = fma(x3, vec4<f32>(high3.y), s[5]);
        s[13] = fma(y3, vec4<f32>(high3.y), s[13]);
        s[6] = fma(x3, vec4<f32>(high3.z), s[6]);
        s[14] = fma(y3, vec4<f32>(high3.z), s[14]);
        s[7] = fma(x3, vec4<f32>(high3.w), s[7]);
        s[15] = fma(y3, vec4<f32>(high3.w), s[15]);
        at += 4u * FOURS;
        weight += 4u * row;
    }
    return s;
}

fn rectified(s: Sums) -> Sums {
    return Sums(
        relu(s[0]), relu(s[1]), relu(s[2]), relu(s[3]),
        relu(s[4]), relu(s[5]), relu(s[6]), relu(s[7]),
        relu(s[8]), relu(s[9]), relu(s[10]), relu(s[11]),
        relu(s[12]), relu(s[13]), relu(s[14]), relu(s[15]),
    );
}

// Puts neurons 8 eight .. 8 eight + 8 of 8 samples into the tile.
fn put(four: u32, eight: u32, s: Sums) {
    let at = 8u * eight * FOURS + four;
    tile[at] = s[0];
    tile[at + HALF] = s[8];
    tile[at + FOURS] = s[1];
    tile[at + FOURS + HALF] = s[9];
    tile[at + 2u * FOURS] = s[2];
    tile[at + 2u * FOURS + HALF] = s[10];
    tile[at + 3u * FOURS] = s[3];
    tile[at + 3u * FOURS + HALF] = s[11];
    tile[at + 4u * FOURS] = s[4];
    tile[at + 4u * FOURS + HALF] = s[12];
    tile[at + 5u * FOURS] = s[5];
    tile[at + 5u * FOURS + HALF] = s[13];
    tile[at + 6u * FOURS] = s[6];
    tile[at + 6u * FOURS + HALF] = s[14];
    tile[at + 7u * FOURS] = s[7];
    tile[at + 7u * FOURS + HALF] = s[15];
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
