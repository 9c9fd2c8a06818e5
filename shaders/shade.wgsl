// shade: the colour network over kept samples, and their colours.
//
// Source    NeRF, arXiv 2003.08934, section 3: density does not see the direction, colour does. Logits are cut at
//           +-LOGIT_LIMIT (0.99995, beyond 8 bits).
// Twin      marf_field::cpu::net::Net::forward and marf_field::cpu::composite::Colours, within 1e-6.
// Threads   one workgroup of 64 a tile of 4 FOURS samples, folded over x and y.
// Reads     `latent` [16][capacity] of visited samples, `origin` [capacity] (the visited sample of each kept one),
//           `ray_of` [capacity] of visited ones. `directions` [rays] (w is 0 where there is no ray), `weights`,
//           `counts`[COUNT_KEPT] samples in use.
// Writes    `colours` [6][capacity], samples in use rounded up to 4, each element once: sRGB in (0, 1), then the three
//           logits. `faults`[FAULT_LOGITS] where a logit of a sample in use runs away.
// Extremes  NaN counts as the upper limit and is a fault. The 13 unused outputs are not checked.
@group(0) @binding(0) var<uniform> run: NetsRun;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> latent: array<f32>;
@group(0) @binding(3) var<storage, read> origin: array<u32>;
@group(0) @binding(4) var<storage, read> ray_of: array<u32>;
@group(0) @binding(5) var<storage, read> directions: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> weights: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> colours: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> faults: array<atomic<u32>>;

fn latent_at(at: u32) -> f32 {
    if at == 0xffffffffu { return 0.0; }
    return latent[at];
}

fn shaded(x: vec4<f32>) -> vec4<f32> {
    return vec4(colour_of(x.x), colour_of(x.y), colour_of(x.z), colour_of(x.w));
}

fn any_is_wild(x: vec4<f32>, sample: u32, in_use: u32) -> bool {
    let live = vec4(sample, sample + 1u, sample + 2u, sample + 3u) < vec4(in_use);
    return any(live & vec4(runs_away(x.x), runs_away(x.y), runs_away(x.z), runs_away(x.w)));
}

// Writes a channel of 4 samples: colour and logit.
fn put_channel(at: u32, in_use: u32, channel: u32, logit: vec4<f32>) {
    let column = run.capacity / 4u;
    colours[channel * column + at] = shaded(logit);
    colours[(3u + channel) * column + at] = logit;
    if any_is_wild(logit, 4u * at, in_use) { atomicMax(&faults[FAULT_LOGITS], 1u); }
}

// Colours of 4 samples from the first three outputs of the last layer.
fn colour_four(at: u32, in_use: u32, red: vec4<f32>, green: vec4<f32>, blue: vec4<f32>) {
    if 4u * at >= in_use { return; }
    put_channel(at, in_use, 0u, red);
    put_channel(at, in_use, 1u, green);
    put_channel(at, in_use, 2u, blue);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) me: u32,
) {
    let first = (group.x + group.y * groups.x) * FOURS;
    let in_use = min(counts[COUNT_KEPT], run.capacity);
    if 4u * first >= in_use { return; }
    for (var at = me; at < 16u * FOURS; at += THREADS) {
        let places = bring_column(at / FOURS, 4u * (first + at % FOURS), in_use);
        tile[at] = vec4(latent_at(places.x), latent_at(places.y), latent_at(places.z), latent_at(places.w));
    }
    if run.directed == 1u { bring_harmonics(first, in_use, me); }
    workgroupBarrier();
    if DENSITY + 1u < LAYERS { advance(run.shapes[DENSITY], me, true); }
    if DENSITY + 2u < LAYERS { advance(run.shapes[DENSITY + 1u], me, true); }
    if DENSITY + 3u < LAYERS { advance(run.shapes[DENSITY + 2u], me, true); }
    if me < HALF {
        let logits = ahead(run.shapes[LAYERS - 1u], me, 0u);
        colour_four(first + me, in_use, logits[0], logits[1], logits[2]);
        colour_four(first + me + HALF, in_use, logits[8], logits[9], logits[10]);
    }
}
