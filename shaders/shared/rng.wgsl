// Random numbers by counter: streams of SplitMix64 (Steele, Lea and Flood 2014), twin of marf_field::rng, equal bit
// for bit. A 64-bit number is (low, high): core WebGPU has no 64-bit integers, nor the high half of a product.
const GOLDEN = vec2<u32>(0x7f4a7c15u, 0x9e3779b9u);

fn add64(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let low = a.x + b.x;
    return vec2(low, a.y + b.y + select(0u, 1u, low < a.x));
}

// a b, all 64 bits. No sum of halves overflows: (2^16 - 1)^2 + 2^16 - 1 < 2^32.
fn mul32(a: u32, b: u32) -> vec2<u32> {
    let one = vec2(a & 0xffffu, a >> 16u);
    let other = vec2(b & 0xffffu, b >> 16u);
    let low = one.x * other.x;
    let upper = one.y * other.x + (low >> 16u);
    let lower = one.x * other.y + (upper & 0xffffu);
    return vec2((lower << 16u) | (low & 0xffffu), one.y * other.y + (upper >> 16u) + (lower >> 16u));
}

// The low 64 bits of a b.
fn mul64(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let low = mul32(a.x, b.x);
    return vec2(low.x, low.y + a.x * b.y + a.y * b.x);
}

// The high 64 bits of a b.
fn high64(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let across = mul32(a.x, b.y);
    let back = mul32(a.y, b.x);
    let middle = add64(add64(vec2(mul32(a.x, b.x).y, 0u), vec2(across.x, 0u)), vec2(back.x, 0u));
    let carried = add64(add64(vec2(middle.y, 0u), vec2(across.y, 0u)), vec2(back.y, 0u));
    return add64(mul32(a.y, b.y), carried);
}

// z ^ (z >> by), for 0 < by < 32.
fn fold64(z: vec2<u32>, by: u32) -> vec2<u32> {
    return z ^ vec2((z.x >> by) | (z.y << (32u - by)), z.y >> by);
}

// A bijection of 64 bits (finaliser of SplitMix64).
fn mix64(z: vec2<u32>) -> vec2<u32> {
    let once = mul64(fold64(z, 30u), vec2(0x1ce4e5b9u, 0xbf58476du));
    let twice = mul64(fold64(once, 27u), vec2(0x133111ebu, 0x94d049bbu));
    return fold64(twice, 31u);
}

// The stream of (seed, purpose, step, index).
fn rng_new(seed: vec2<u32>, purpose: u32, step: vec2<u32>, index: vec2<u32>) -> vec2<u32> {
    let seeded = add64(mix64(add64(seed, GOLDEN)), mul64(vec2(purpose, 0u), GOLDEN));
    let stepped = add64(mix64(seeded), mul64(step, GOLDEN));
    return mix64(add64(mix64(stepped), mul64(index, GOLDEN)));
}

// 64 random bits.
fn rng_bits(rng: ptr<function, vec2<u32>>) -> vec2<u32> {
    *rng = add64(*rng, GOLDEN);
    return mix64(*rng);
}

// A number in [0, 1), a multiple of 2^-24: 24 bits as a float and their shift are exact.
fn rng_unit(rng: ptr<function, vec2<u32>>) -> f32 {
    return f32(rng_bits(rng).y >> 8u) * 5.9604644775390625e-8;
}

// An integer in [0, n), 0 if n is 0.
fn rng_below(rng: ptr<function, vec2<u32>>, n: vec2<u32>) -> vec2<u32> {
    return high64(rng_bits(rng), n);
}
