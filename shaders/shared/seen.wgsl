// Brings kept samples into a tile; after tile.wgsl and sh.wgsl. The kernel declares `counts`, `origin`, `ray_of` and
// `directions`.

// The first rows of the tile from columns of visited samples; 0 where no sample is in use.
fn bring_column(at: u32, sample: u32, in_use: u32) -> vec4<u32> {
    let live = vec4(sample, sample + 1u, sample + 2u, sample + 3u) < vec4(in_use);
    let row = at * run.capacity;
    return vec4(
        select(0xffffffffu, row + origin[sample], live.x),
        select(0xffffffffu, row + origin[sample + 1u], live.y),
        select(0xffffffffu, row + origin[sample + 2u], live.z),
        select(0xffffffffu, row + origin[sample + 3u], live.w),
    );
}

// The 16 harmonics of the direction a sample is seen from; 0 where there is none.
fn harmonics_at(sample: u32, in_use: u32) -> array<f32, 16> {
    if sample >= in_use { return array<f32, 16>(); }
    let direction = directions[ray_of[origin[sample]]];
    if !(direction.w > 0.0) { return array<f32, 16>(); }
    return harmonics_of(direction.xyz);
}

// Rows 16 to 31 of the tile: harmonics of 4 samples.
fn bring_harmonics(four: u32, sample: u32, in_use: u32) {
    var h0 = harmonics_at(sample, in_use);
    var h1 = harmonics_at(sample + 1u, in_use);
    var h2 = harmonics_at(sample + 2u, in_use);
    var h3 = harmonics_at(sample + 3u, in_use);
    for (var index = 0u; index < 16u; index++) {
        tile[(16u + index) * FOURS + four] = vec4(h0[index], h1[index], h2[index], h3[index]);
    }
}
