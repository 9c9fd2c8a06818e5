//! Numbers that decide quality, found on the pairs of benches/stereo.md.
#![allow(missing_docs, reason = "trial")]
fn env(name: &str, default: f64) -> f64 {
    std::env::var(name)
        .ok()
        .and_then(|v| v.parse().ok())
        .unwrap_or(default)
}
pub(crate) const FULL_CELLS: usize = 64 << 20;
pub(crate) const FINE_CANDIDATES: usize = 32;
pub(crate) const ISLAND: usize = 100;
pub(crate) struct T {
    pub one: u8,
    pub flat: u8,
    pub edge: u8,
    pub half_at: u16,
    pub eps: f32,
    pub rounds: usize,
}
pub(crate) static T: std::sync::LazyLock<T> = std::sync::LazyLock::new(|| T {
    one: env("ONE", 12.0) as u8,
    flat: env("FLAT", 96.0) as u8,
    edge: env("EDGE", 24.0) as u8,
    half_at: env("HALF", 8.0) as u16,
    eps: env("EPS", 20.0) as f32,
    rounds: env("ROUNDS", 3.0) as usize,
    reach0: env("REACH0", 2.0) as f32,
    reach: env("REACH", 1.0) as f32,
    radius: env("RADIUS", 4.0) as usize,
    space: env("SPACE", 100.0) as f32,
    tone: env("TONE", 1000.0) as f32,
    ridge: env("RIDGE", 0.05) as f32,
    unique: env("UNIQ", 4.0) as u32,
    sigma_max: env("SIGMAX", 9.0) as f32,
    drift: env("DRIFT", 1.5) as f32,
});
