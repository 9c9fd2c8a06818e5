//! Lineages of a small pipeline.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

#[path = "../../../model/tests/model/common.rs"]
mod common;
mod diff;
mod find;
mod taint;
mod verify;
