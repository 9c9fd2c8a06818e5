// hash_encode: multiresolution hash-grid lookup, forward pass.
//
// Source    instant-ngp, arXiv 2201.05989, section 3, eq. 4; F = 4 features an entry.
// Twin      marf_field::cpu::encode (same corners, same hash, same order of sums).
// Threads   one per (point, level): workgroup 64 x 1, dispatch (ceil(points / 64), levels).
// Reads     xyz [N, 3] in the unit box, level [L] (cells a side, entries, first entry, dense or hashed),
//           table [sum of entries] of vec4
// Writes    features [N, L] of vec4, each element exactly once: order does not matter
// Extremes  x = 1 belongs to the last cell. NaN is refused on the CPU before upload (clamp of NaN is undefined
//           here). resolution comes from the CPU: floor(base * growth^l) may differ by one on a GPU.

struct Size {
    points: u32,
    levels: u32,
}

struct Level {
    resolution: u32,
    entries: u32,
    first: u32,
    dense: u32,
}

@group(0) @binding(0) var<uniform> size: Size;
@group(0) @binding(1) var<storage, read> levels: array<Level>;
@group(0) @binding(2) var<storage, read> xyz: array<f32>;
@group(0) @binding(3) var<storage, read> table: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> features: array<vec4<f32>>;

fn entry(level: Level, corner: vec3<u32>) -> u32 {
    if level.dense == 1u {
        let side = level.resolution + 1u;
        return corner.x + side * (corner.y + side * corner.z);
    }
    // x has multiplier 1, so that neighbours along x share a line; entries is a power of two here.
    return (corner.x ^ (corner.y * 2654435761u) ^ (corner.z * 805459861u)) & (level.entries - 1u);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= size.points || id.y >= size.levels {
        return;
    }
    let level = levels[id.y];
    let at = vec3<f32>(xyz[3u * id.x], xyz[3u * id.x + 1u], xyz[3u * id.x + 2u]);
    let q = clamp(at, vec3<f32>(0.0), vec3<f32>(1.0)) * f32(level.resolution);
    let cell = min(vec3<u32>(q), vec3<u32>(level.resolution - 1u));
    let share = q - vec3<f32>(cell);
    var sum = vec4<f32>(0.0);
    for (var corner = 0u; corner < 8u; corner++) {
        let step = vec3<u32>(corner & 1u, (corner >> 1u) & 1u, corner >> 2u);
        let part = select(vec3<f32>(1.0) - share, share, step == vec3<u32>(1u));
        let weight = part.x * part.y * part.z;
        sum = fma(vec4<f32>(weight), table[level.first + entry(level, cell + step)], sum);
    }
    features[id.x * size.levels + id.y] = sum;
}
