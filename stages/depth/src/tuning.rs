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
    one: env("ONE", 8.0) as u8,
    flat: env("FLAT", 96.0) as u8,
    edge: env("EDGE", 24.0) as u8,
    half_at: env("HALF", 8.0) as u16,
    eps: env("EPS", 2.0) as f32,
    rounds: env("ROUNDS", 3.0) as usize,
});
