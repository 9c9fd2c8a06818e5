// Spreads the gradients of the features of EACH samples, one after the other on a ray or nearly so, on the 8
// entries around each, in fixed point. Contributions to one entry are added up first, in integers, which any
// order leaves the same. The kernel has its own `add`.
// Needs of the head: Row, Quanta, Sizes, FEATURES, MOST_QUANTA.
@group(0) @binding(0) var<uniform> part: GridPart;
@group(0) @binding(1) var<storage, read> levels: array<GridLevel>;
@group(0) @binding(2) var<storage, read> counts: array<u32>;
@group(0) @binding(3) var<storage, read> xyz: array<f32>;
@group(0) @binding(4) var<storage, read> slopes: array<f32>;
@group(0) @binding(5) var<storage, read_write> scales: array<LevelScale>;
@group(0) @binding(7) var<storage, read> origin: array<u32>;

const EACH: u32 = 8u;

// The cell whose corners are summed, and their sums: corner x + 2 y + 4 z.
var<private> here: vec3<u32>;
var<private> s0: Quanta;
var<private> s1: Quanta;
var<private> s2: Quanta;
var<private> s3: Quanta;
var<private> s4: Quanta;
var<private> s5: Quanta;
var<private> s6: Quanta;
var<private> s7: Quanta;

// Rounds to quanta. What is more than MOST_QUANTA, infinite or NaN becomes MOST_QUANTA and marks the level.
fn rounded(value: Row, level: u32) -> Quanta {
    let bits = bitcast<Sizes>(value);
    let fits = (bits & Sizes(0x7fffffffu)) <= Sizes(bitcast<u32>(f32(MOST_QUANTA)));
    if !all(fits) { atomicMax(&scales[level].clamped, 1u); }
    let most = select(Quanta(-MOST_QUANTA), Quanta(MOST_QUANTA), bits < Sizes(0x80000000u));
    return select(most, Quanta(round(value)), fits);
}

fn give(level: GridLevel, corner: u32, sum: Quanta) {
    if any(sum != Quanta(0)) { add(level.first - part.base + entry_of(level, here, corner), sum); }
}

// The cell's neighbour along an axis: the far side becomes the near one, or the other way round.
fn move_x(level: GridLevel, up: bool) {
    let none = Quanta(0);
    if up {
        give(level, 0u, s0);
        give(level, 2u, s2);
        give(level, 4u, s4);
        give(level, 6u, s6);
        s0 = s1; s2 = s3; s4 = s5; s6 = s7;
        s1 = none; s3 = none; s5 = none; s7 = none;
        here.x += 1u;
    } else {
        give(level, 1u, s1);
        give(level, 3u, s3);
        give(level, 5u, s5);
        give(level, 7u, s7);
        s1 = s0; s3 = s2; s5 = s4; s7 = s6;
        s0 = none; s2 = none; s4 = none; s6 = none;
        here.x -= 1u;
    }
}

fn move_y(level: GridLevel, up: bool) {
    let none = Quanta(0);
    if up {
        give(level, 0u, s0);
        give(level, 1u, s1);
        give(level, 4u, s4);
        give(level, 5u, s5);
        s0 = s2; s1 = s3; s4 = s6; s5 = s7;
        s2 = none; s3 = none; s6 = none; s7 = none;
        here.y += 1u;
    } else {
        give(level, 2u, s2);
        give(level, 3u, s3);
        give(level, 6u, s6);
        give(level, 7u, s7);
        s2 = s0; s3 = s1; s6 = s4; s7 = s5;
        s0 = none; s1 = none; s4 = none; s5 = none;
        here.y -= 1u;
    }
}

fn move_z(level: GridLevel, up: bool) {
    let none = Quanta(0);
    if up {
        give(level, 0u, s0);
        give(level, 1u, s1);
        give(level, 2u, s2);
        give(level, 3u, s3);
        s0 = s4; s1 = s5; s2 = s6; s3 = s7;
        s4 = none; s5 = none; s6 = none; s7 = none;
        here.z += 1u;
    } else {
        give(level, 4u, s4);
        give(level, 5u, s5);
        give(level, 6u, s6);
        give(level, 7u, s7);
        s4 = s0; s5 = s1; s6 = s2; s7 = s3;
        s0 = none; s1 = none; s2 = none; s3 = none;
        here.z -= 1u;
    }
}

// Adds all sums to the entries. The next cell begins with none.
fn leave(level: GridLevel, cell: vec3<u32>) {
    give(level, 0u, s0);
    give(level, 1u, s1);
    give(level, 2u, s2);
    give(level, 3u, s3);
    give(level, 4u, s4);
    give(level, 5u, s5);
    give(level, 6u, s6);
    give(level, 7u, s7);
    s0 = Quanta(0); s1 = s0; s2 = s0; s3 = s0; s4 = s0; s5 = s0; s6 = s0; s7 = s0;
    here = cell;
}

// Goes to the cell of the next sample. Corners that both cells share keep their sums.
fn go(level: GridLevel, cell: vec3<u32>) {
    let step = vec3<i32>(cell) - vec3<i32>(here);
    if any(abs(step) > vec3(1)) {
        leave(level, cell);
        return;
    }
    if step.x != 0 { move_x(level, step.x > 0); }
    if step.y != 0 { move_y(level, step.y > 0); }
    if step.z != 0 { move_z(level, step.z > 0); }
}

fn spread_one(sample: u32, number: u32, level: GridLevel, scale: f32) {
    let capacity = part.capacity;
    let seen = origin[sample];
    let at = vec3<f32>(unit(xyz[seen]), unit(xyz[capacity + seen]), unit(xyz[2u * capacity + seen]));
    let q = at * f32(level.resolution);
    let cell = cell_of(q, level.resolution);
    let share = q - vec3<f32>(cell);
    let weights = across(share);
    var slope = Row(0.0);
    let row = number * FEATURES * capacity + sample;
    slope.x = slopes[row];
    slope.y = slopes[row + capacity];
    if FEATURES > 2u {
        slope[FEATURES / 2u] = slopes[row + 2u * capacity];
        slope[FEATURES - 1u] = slopes[row + 3u * capacity];
    }
    let below = slope * (1.0 - share.x);
    let above = slope * share.x;
    go(level, cell);
    s0 += rounded(weights.x * below * scale, number);
    s1 += rounded(weights.x * above * scale, number);
    s2 += rounded(weights.y * below * scale, number);
    s3 += rounded(weights.y * above * scale, number);
    s4 += rounded(weights.z * below * scale, number);
    s5 += rounded(weights.z * above * scale, number);
    s6 += rounded(weights.w * below * scale, number);
    s7 += rounded(weights.w * above * scale, number);
}

fn spread(first: u32, in_use: u32, number: u32) {
    let level = levels[number];
    let scale = scales[number].scale;
    let end = min(first + EACH, in_use);
    for (var sample = first; sample < end; sample++) { spread_one(sample, number, level, scale); }
    if first < end { leave(level, here); }
}
