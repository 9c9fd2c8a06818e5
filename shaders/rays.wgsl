// rays: draws pixel and jitter of every ray of a training step and sets the ray out.
//
// Source    uniform over all kept pixels of all photos, drawn again where a mask hides the pixel. While sparse points
//           pull, every `share`th ray is uniform over the pixels that see one (DS-NeRF, arXiv 2107.02791, draws them in
//           the same batch).
// Twin      marf_field::draw::Training::target. Pixel, colour, view, jitter, origin, pull equal bit for bit, direction
//           within 2e-6 (shared/camera.wgsl).
// Threads   one per ray: workgroup 64, folded.
// Reads     `step`. `cameras` [views]. `pixels` [kept]: r | g << 8 | b << 16 | place in its run, or HIDDEN, << 24.
//           `alphas`: opacities of the kept pixels of photos with transparency, 4 a word from the lowest byte on.
//           `observations` [S].
// Writes    `origins`, `directions` [rays wanted] vec4, `targets` [rays wanted], `pulls` [rays wanted] vec2, each once.
//           No slot beyond.
// Extremes  no inverse of the distortion, or hidden after all draws: directions.w is 0. An observation beyond the last
//           step pulls with weight 0. observations = 0: no ray goes to one.
struct Observed {
    // Number of the pixel among all kept.
    pixel: u32,
    // Number of the step at the point as a share of all steps.
    place: f32,
    // Share of the weight of a pull. 0 beyond the steps.
    share: f32,
}

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> cameras: array<ViewCamera>;
@group(0) @binding(2) var<storage, read> pixels: array<u32>;
@group(0) @binding(3) var<storage, read> observations: array<Observed>;
@group(0) @binding(4) var<storage, read_write> origins: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> directions: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> targets: array<Target>;
@group(0) @binding(7) var<storage, read_write> pulls: array<vec2<f32>>;
@group(0) @binding(8) var<storage, read> alphas: array<u32>;

// The view that a pixel belongs to: the last whose first pixel is not behind it.
fn view_of(pixel: u32) -> u32 {
    var low = 0u;
    var high = step.views;
    while high - low > 1u {
        let middle = (low + high) / 2u;
        if cameras[middle].first <= pixel { low = middle; } else { high = middle; }
    }
    return low;
}

// c / 255 rounded to the nearest f32, as the CPU's division does: a GPU's own division may be off by 2.5 ulp.
fn share_of_255(c: u32) -> f32 {
    if c == 0u { return 0.0; }
    // With the top bit of c at bit 7 the quotient has 24 bits.
    let shift = countLeadingZeros(c) - 24u;
    let scaled = (c << shift) << 24u;
    let whole = scaled / 255u;
    let rounded = whole + select(0u, 1u, 2u * (scaled - whole * 255u) > 255u);
    // 2^-(24 + shift): a power of two scales exactly.
    return f32(rounded) * bitcast<f32>((103u - shift) << 23u);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let ray = flat(id, groups);
    if ray >= step.rays { return; }
    var rng = rng_new(step.seed, PURPOSE, step.number, vec2(ray, 0u));
    var pull = vec2(0.0);
    var pixel = 0u;
    if step.observations > 0u && ray % step.share == 0u {
        let seen = observations[rng_below(&rng, vec2(step.observations, 0u)).x];
        pixel = seen.pixel;
        pull = vec2(seen.place, step.pull * seen.share);
    } else {
        for (var draw = 0u; draw < DRAWS; draw++) {
            pixel = rng_below(&rng, vec2(step.pixels, 0u)).x;
            if pixels[pixel] >> 24u != HIDDEN { break; }
        }
    }
    let jitter = rng_unit(&rng);
    let view = view_of(pixel);
    let camera = cameras[view];
    let packed = pixels[pixel];
    let place = (pixel - camera.first) * camera.run + (packed >> 24u);
    let centre = vec2(f32(place % camera.width), f32(place / camera.width)) + 0.5;
    origins[ray] = vec4(centre_of(camera), jitter);
    directions[ray] = ray_behind(camera, centre);
    if packed >> 24u == HIDDEN { directions[ray] = vec4(0.0); }
    let rgb = vec3(
        share_of_255(packed & 255u), share_of_255((packed >> 8u) & 255u), share_of_255((packed >> 16u) & 255u)
    );
    var behind = vec3(0.0);
    var share = -1.0;
    if camera.alpha > 0u {
        behind.x = rng_unit(&rng);
        behind.y = rng_unit(&rng);
        behind.z = rng_unit(&rng);
        let at = camera.alpha - 1u + pixel - camera.first;
        share = share_of_255(255u - ((alphas[at / 4u] >> (8u * (at % 4u))) & 255u));
    }
    targets[ray] = Target(rgb, view, behind, share);
    pulls[ray] = pull;
}
