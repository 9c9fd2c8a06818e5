// view_rays: sets out the rays of some pixels of one photo, in the order of its rows.
//
// Source    Pixel (0, 0) is the top-left corner. A ray goes through the middle of its pixel.
// Twin      marf_field::frame::Frame::ray at (column + 0.5, row + 0.5). Origin equal bit for bit, direction within 2e-6
//           (shared/camera.wgsl).
// Threads   one per pixel: workgroup 64, folded.
// Reads     `asked`: camera, first pixel, count, place within every step.
// Writes    `origins`, `directions` [count] vec4. `next_step`, `done` [count], all 0. Each once, no slot beyond.
// Extremes  no inverse of the distortion: directions.w is 0. A pixel below the last row has none either.
struct PixelRange {
    camera: ViewCamera,
    first: u32,
    count: u32,
    jitter: f32,
    pad0: u32,
}

@group(0) @binding(0) var<uniform> asked: PixelRange;
@group(0) @binding(1) var<storage, read_write> origins: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> directions: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> next_step: array<u32>;
@group(0) @binding(4) var<storage, read_write> done: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let ray = flat(id, groups);
    if ray >= asked.count { return; }
    let camera = asked.camera;
    let pixel = asked.first + ray;
    let place = vec2(pixel % camera.width, pixel / camera.width);
    origins[ray] = vec4(centre_of(camera), asked.jitter);
    var direction = vec4(0.0);
    if place.y < camera.height { direction = ray_behind(camera, vec2<f32>(place) + 0.5); }
    directions[ray] = direction;
    next_step[ray] = 0u;
    done[ray] = 0u;
}
