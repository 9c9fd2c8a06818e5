// The 8 corners around a point on one level: `Corners` of marf_field::cpu::encode, product by product.
// Needs of the head: PRIME_Y, PRIME_Z, multipliers of the spatial hash (instant-ngp, eq. 4).
struct GridLevel {
    resolution: u32,
    entries: u32,
    first: u32,
    dense: u32,
}

// Cut to [0, 1]. NaN becomes 0. The bits of all positive numbers, and of no NaN, are 1 to 0x7f800000.
fn unit(x: f32) -> f32 {
    let above = select(0.0, x, bitcast<u32>(x) - 1u < 0x7f800000u);
    return select(1.0, above, above < 1.0);
}

// The cell of a point given in cells. The last one includes its far side.
fn cell_of(q: vec3<f32>, resolution: u32) -> vec3<u32> {
    return min(vec3<u32>(q), vec3<u32>(max(resolution, 1u) - 1u));
}

// Products of the weights along y and z, y + 2 z.
fn across(share: vec3<f32>) -> vec4<f32> {
    let rest = 1.0 - share;
    return vec4<f32>(rest.y * rest.z, share.y * rest.z, rest.y * share.z, share.y * share.z);
}

// Entry of a corner within its level. corner = x + 2 y + 4 z.
fn entry_of(level: GridLevel, cell: vec3<u32>, corner: u32) -> u32 {
    let at = cell + (vec3<u32>(corner, corner >> 1u, corner >> 2u) & vec3<u32>(1u));
    if level.dense == 1u {
        let side = level.resolution + 1u;
        return at.x + side * (at.y + side * at.z);
    }
    return (at.x ^ (at.y * PRIME_Y) ^ (at.z * PRIME_Z)) & (level.entries - 1u);
}
