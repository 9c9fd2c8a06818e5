//! Lineages of a small pipeline.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

mod common;
mod diff;
mod find;
mod lineage;
mod taint;
mod verify;
