//! Crates of a small run: written, read back, altered.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

mod altered;
mod fixture;
mod forged;
mod whole;
