// Colours of logits, as marf_field::cpu::composite. Goes after math.wgsl. The head gives LOGIT_LIMIT.
fn colour_of(logit: f32) -> f32 {
    let below = select(LOGIT_LIMIT, logit, logit < LOGIT_LIMIT);
    return sigmoid_own(select(-LOGIT_LIMIT, below, below > -LOGIT_LIMIT));
}

// Slope of colour_of, from its value.
fn colour_slope(logit: f32, value: f32) -> f32 {
    return select(0.0, value * (1.0 - value), abs(logit) < LOGIT_LIMIT);
}

// A product of vectors in the order of the CPU.
fn dot_own(a: vec3<f32>, b: vec3<f32>) -> f32 {
    return fma(a.x, b.x, fma(a.y, b.y, a.z * b.z));
}
