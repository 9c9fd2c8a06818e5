// Spreads the gradient of a sample's features on the 8 entries around it, in fixed point; `add` is the kernel's.
// Needs of the head: Row, Quanta, FEATURES, MOST_QUANTA.
@group(0) @binding(0) var<uniform> part: GridPart;
@group(0) @binding(1) var<storage, read> levels: array<GridLevel>;
@group(0) @binding(2) var<storage, read> counts: array<u32>;
@group(0) @binding(3) var<storage, read> xyz: array<f32>;
@group(0) @binding(4) var<storage, read> slopes: array<f32>;
@group(0) @binding(5) var<storage, read_write> scales: array<LevelScale>;

// Rounds to quanta. What is more than MOST_QUANTA, infinite or NaN becomes MOST_QUANTA and marks the level.
fn rounded(value: Row, level: u32) -> Quanta {
    var quanta = Quanta(0);
    for (var f = 0u; f < FEATURES; f++) {
        let bits = bitcast<u32>(value[f]);
        if (bits & 0x7fffffffu) <= bitcast<u32>(f32(MOST_QUANTA)) {
            quanta[f] = i32(round(value[f]));
        } else {
            quanta[f] = select(-MOST_QUANTA, MOST_QUANTA, bits < 0x80000000u);
            atomicMax(&scales[level].clamped, 1u);
        }
    }
    return quanta;
}

fn spread(sample: u32, number: u32) {
    let capacity = part.capacity;
    let level = levels[number];
    let at = vec3<f32>(unit(xyz[sample]), unit(xyz[capacity + sample]), unit(xyz[2u * capacity + sample]));
    let q = at * f32(level.resolution);
    let cell = cell_of(q, level.resolution);
    let share = q - vec3<f32>(cell);
    let weights = across(share);
    var slope = Row(0.0);
    for (var f = 0u; f < FEATURES; f++) {
        slope[f] = slopes[(number * FEATURES + f) * capacity + sample];
    }
    let below = slope * (1.0 - share.x);
    let above = slope * share.x;
    let scale = scales[number].scale;
    let first = level.first - part.base;
    for (var side = 0u; side < 4u; side++) {
        let weight = weights[side];
        add(first + entry_of(level, cell, 2u * side), rounded(weight * below * scale, number));
        add(first + entry_of(level, cell, 2u * side + 1u), rounded(weight * above * scale, number));
    }
}
