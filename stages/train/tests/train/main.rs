//! The stages of this crate, each with the real field: one program, which the compiler links once.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

mod bootstrap;
#[path = "../common/mod.rs"]
mod common;
mod decodes;
mod distances;
mod exposure;
mod folds;
mod length;
mod members;
mod partial;
mod render;
mod resumed;
mod search;
mod tiny_scene;
#[cfg(feature = "h264")]
mod video;
mod warm_start;
