// finish: rays of a picture to colour over the background, opacity and depth.
//
// Source    NeRF, arXiv 2003.08934, eq. 3.
// Twin      marf_field::render::Walk::pixel, within 1e-6.
// Threads   one per ray: workgroup 64, folded.
// Reads     `state` [6][rays] of `paint`, `directions` [rays] (w 0: no ray), `background` [3][16], `counts`[slot] rays
//           in use.
// Writes    `picture` [5][rays] of rays in use, each element once: rgb, opacity in [0, 1], depth in world units.
// Extremes  a missing ray is black, empty, at depth 0. Where opacity is 0 or the quotient not finite, depth is 0.
struct FinishRun {
    slot: u32,
    rays: u32,
    behind: u32,
    half_side: f32,
}
@group(0) @binding(0) var<uniform> run: FinishRun;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> state: array<f32>;
@group(0) @binding(3) var<storage, read> directions: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> background: array<f32>;
@group(0) @binding(5) var<storage, read_write> picture: array<f32>;

fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7fffffffu) < 0x7f800000u;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let ray = flat(id, groups);
    if ray >= run.rays || ray >= counts[run.slot] { return; }
    let direction = directions[ray];
    var rgb = vec3<f32>(0.0);
    var opacity = 0.0;
    var depth = 0.0;
    if direction.w > 0.0 {
        let left = state[5u * run.rays + ray];
        var behind = vec3<f32>(0.0);
        if run.behind == 1u { behind = colours_of(logits_behind(harmonics_of(direction.xyz))); }
        let sum = vec3<f32>(state[run.rays + ray], state[2u * run.rays + ray], state[3u * run.rays + ray]);
        rgb = fma(vec3<f32>(left), behind, sum);
        let gone = 1.0 - left;
        let above = select(0.0, gone, gone > 0.0);
        opacity = select(1.0, above, above < 1.0);
        if opacity > 0.0 {
            let found = state[4u * run.rays + ray] / opacity * run.half_side;
            depth = select(0.0, found, is_finite(found));
        }
    }
    picture[ray] = rgb.x;
    picture[run.rays + ray] = rgb.y;
    picture[2u * run.rays + ray] = rgb.z;
    picture[3u * run.rays + ray] = opacity;
    picture[4u * run.rays + ray] = depth;
}
