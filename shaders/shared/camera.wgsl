// A camera with its pose, and the rays behind its pixels: twin of marf_scene::Camera::unproject and
// marf_field::frame::Frame::ray, same iteration in f32. NEWTON_STEPS comes with the head.
//
// Directions are within 2e-6 of f64 where the distortion still rises by a tenth of its rise in the middle.
// Nearer to its fold the error grows as 2e-7 over that slope: a pixel determines the direction no better
// there.
struct ViewCamera {
    // fx, fy, cx, cy, pixels
    lens: vec4<f32>,
    // k1, k2, p1, p2
    distortion: vec4<f32>,
    // Rows of the rotation from the camera to the world. w is the centre, half sides.
    row_x: vec4<f32>,
    row_y: vec4<f32>,
    row_z: vec4<f32>,
    // Number of its first kept pixel, pixels of a run with one kept, size of the photo.
    first: u32,
    run: u32,
    width: u32,
    height: u32,
    // Number of the opacity of its first kept pixel, and 1. 0: it is opaque.
    alpha: u32,
    pad0: u32,
    pad1: u32,
    pad2: u32,
}

// Newton's steps end where rounding does not let the error fall, for |x| of 1. f64 goes to 1e-14.
const SOLVED: f32 = 1e-7;
// Rounding leaves 5e-7 for |x| of 1, so solved errors are below this. f64 asks for 1e-9. An unsolved pixel is
// beyond the fold, by that much: within 1e-5 of a focal length of it, a hundredth of a pixel, f64 may judge
// otherwise.
const CLOSED: f32 = 1e-5;

fn distorted(distortion: vec4<f32>, plane: vec2<f32>) -> vec2<f32> {
    let r2 = dot(plane, plane);
    let radial = 1.0 + r2 * (distortion.x + r2 * distortion.y);
    let product = 2.0 * plane.x * plane.y;
    let aside = vec2(distortion.w * (r2 + 2.0 * plane.x * plane.x), distortion.z * (r2 + 2.0 * plane.y * plane.y));
    return plane * radial + distortion.zw * product + aside;
}

// The step (x, y) of Newton's method and the determinant, whose size shows whether there is a step.
fn newton_step(distortion: vec4<f32>, plane: vec2<f32>, error: vec2<f32>) -> vec3<f32> {
    let r2 = dot(plane, plane);
    let radial = 1.0 + r2 * (distortion.x + r2 * distortion.y);
    let slope = 2.0 * (distortion.x + 2.0 * distortion.y * r2);
    let xx = radial + slope * plane.x * plane.x + 2.0 * distortion.z * plane.y + 6.0 * distortion.w * plane.x;
    let xy = slope * plane.x * plane.y + 2.0 * distortion.z * plane.x + 2.0 * distortion.w * plane.y;
    let yy = radial + slope * plane.y * plane.y + 6.0 * distortion.z * plane.y + 2.0 * distortion.w * plane.x;
    let determinant = xx * yy - xy * xy;
    return vec3(vec2(yy * error.x - xy * error.y, xx * error.y - xy * error.x) / determinant, determinant);
}

// Whether the radial map still rises at r2, and before: its slope is a parabola in r2.
fn unfolded(distortion: vec4<f32>, r2: f32) -> bool {
    var lowest = 0.0;
    if distortion.y > 0.0 {
        let vertex = -0.3 * distortion.x / distortion.y;
        lowest = select(0.0, select(r2, vertex, vertex < r2), vertex > 0.0);
    }
    let here = 1.0 + r2 * (3.0 * distortion.x + r2 * 5.0 * distortion.y);
    let before = 1.0 + lowest * (3.0 * distortion.x + lowest * 5.0 * distortion.y);
    return here > 0.0 && before > 0.0;
}

// NaN and infinity by their bits: comparisons of NaN are not to be relied on.
fn is_finite(plane: vec2<f32>) -> bool {
    let bits = bitcast<vec2<u32>>(plane) & vec2(0x7fffffffu);
    return bits.x < 0x7f800000u && bits.y < 0x7f800000u;
}

fn largest(v: vec2<f32>) -> f32 {
    let size = abs(v);
    return select(size.x, size.y, size.y > size.x);
}

// The direction behind a pixel in the camera, and 1. All zero where the distortion has no inverse.
fn unprojected(camera: ViewCamera, pixel: vec2<f32>) -> vec4<f32> {
    let goal = (pixel - camera.lens.zw) / camera.lens.xy;
    let reach = 1.0 + largest(goal);
    var plane = goal;
    for (var k = 0u; k < NEWTON_STEPS; k++) {
        let error = distorted(camera.distortion, plane) - goal;
        if !is_finite(error) { return vec4(0.0); }
        if largest(error) < SOLVED * reach { break; }
        let solved = newton_step(camera.distortion, plane, error);
        if abs(solved.z) <= 1e-12 { return vec4(0.0); }
        plane -= solved.xy;
    }
    let error = distorted(camera.distortion, plane) - goal;
    let closed = is_finite(error) && largest(error) < CLOSED * reach;
    return select(vec4(0.0), vec4(plane, 1.0, 1.0), closed && unfolded(camera.distortion, dot(plane, plane)));
}

// The unit direction in the world behind a pixel, and 1. All zero without a direction.
fn ray_behind(camera: ViewCamera, pixel: vec2<f32>) -> vec4<f32> {
    let found = unprojected(camera, pixel);
    if found.w == 0.0 { return found; }
    let ahead = found.xyz;
    let turned = vec3(dot(camera.row_x.xyz, ahead), dot(camera.row_y.xyz, ahead), dot(camera.row_z.xyz, ahead));
    return vec4(normalize(turned), 1.0);
}

// The centre of the camera, half sides.
fn centre_of(camera: ViewCamera) -> vec3<f32> {
    return vec3(camera.row_x.w, camera.row_y.w, camera.row_z.w);
}
