// Brings kept samples into a tile. Goes after tile.wgsl and sh.wgsl. The kernel declares `counts`, `origin`,
// `ray_of` and `directions`.

// The first rows of the tile from columns of visited samples. 0 where no sample is in use.
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

// The 16 harmonics of the direction a sample is seen from. 0 where there is none.
fn harmonics_at(sample: u32, in_use: u32) -> array<f32, 16> {
    if sample >= in_use { return array<f32, 16>(); }
    let direction = directions[ray_of[origin[sample]]];
    if !(direction.w > 0.0) { return array<f32, 16>(); }
    return harmonics_of(direction.xyz);
}

// Rows 16 to 31 of the tile: harmonics of all its samples.
fn bring_harmonics(first: u32, in_use: u32, me: u32) {
    for (var sample = me; sample < 4u * FOURS; sample += THREADS) {
        let h = harmonics_at(4u * first + sample, in_use);
        let at = 16u * FOURS + sample / 4u;
        let part = sample % 4u;
        tile[at + 0u * FOURS][part] = h[0];
        tile[at + 1u * FOURS][part] = h[1];
        tile[at + 2u * FOURS][part] = h[2];
        tile[at + 3u * FOURS][part] = h[3];
        tile[at + 4u * FOURS][part] = h[4];
        tile[at + 5u * FOURS][part] = h[5];
        tile[at + 6u * FOURS][part] = h[6];
        tile[at + 7u * FOURS][part] = h[7];
        tile[at + 8u * FOURS][part] = h[8];
        tile[at + 9u * FOURS][part] = h[9];
        tile[at + 10u * FOURS][part] = h[10];
        tile[at + 11u * FOURS][part] = h[11];
        tile[at + 12u * FOURS][part] = h[12];
        tile[at + 13u * FOURS][part] = h[13];
        tile[at + 14u * FOURS][part] = h[14];
        tile[at + 15u * FOURS][part] = h[15];
    }
}
