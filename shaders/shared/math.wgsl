// Own exponentials, in the order of operations of marf_field::cpu::math: built-in ones differ between drivers.
// The head gives RUNAWAY.

// e^x, at the nearer border outside [-87, 88]. NaN gives e^-87.
fn exp_own(x: f32) -> f32 {
    let above = select(-87.0, x, x > -87.0);
    let cut = select(88.0, above, above < 88.0);
    // Adding 1.5 * 2^23 rounds to an integer, which then is in the low bits: read there and not by a
    // subtraction, which a compiler may take away.
    let twos = bitcast<i32>(fma(cut, 1.4426950408889634, 12582912.0)) - 0x4b400000;
    let k = f32(twos);
    // The first part of ln 2 is 22713 / 2^15. It is in integers, because Mesa joins two products by k into
    // one by ln 2, which is off by 3e-6 at -87. All but the last rounding is exact.
    let r = fma(k, -1.4286068e-6, cut - f32(twos * 22713) * 0.000030517578125);
    var p = fma(1.9875691e-4, r, 1.3981999e-3);
    p = fma(p, r, 8.333452e-3);
    p = fma(p, r, 4.1665796e-2);
    p = fma(p, r, 1.6666665e-1);
    p = fma(p, r, 0.5);
    p = fma(p * r, r, r) + 1.0;
    return p * bitcast<f32>((twos + 127) << 23u);
}

// 1 - e^-x for x >= 0, every digit also where x is tiny.
fn one_minus_exp_neg(x: f32) -> f32 {
    var series = fma(1.0f / 362880.0f, x, -1.0f / 40320.0f);
    series = fma(series, x, 1.0f / 5040.0f);
    series = fma(series, x, -1.0f / 720.0f);
    series = fma(series, x, 1.0f / 120.0f);
    series = fma(series, x, -1.0f / 24.0f);
    series = fma(series, x, 1.0f / 6.0f);
    series = fma(series, x, -0.5);
    let small = fma(series * x, x, x);
    let large = 1.0 - exp_own(-x);
    return select(large, small, x < 0.5);
}

// 1 / (1 + e^-x).
fn sigmoid_own(x: f32) -> f32 {
    return 1.0 / (1.0 + exp_own(-x));
}

// NaN, infinite, or as large as the float whose bits are RUNAWAY.
fn runs_away(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7fffffffu) >= RUNAWAY;
}
