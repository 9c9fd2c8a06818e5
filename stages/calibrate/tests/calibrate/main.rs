//! The stages of this crate, from photos to cameras: one program, which the compiler links once.
#![allow(clippy::unwrap_used, reason = "a fixture that is wrong should stop the test")]
#![allow(clippy::print_stdout, reason = "a skipped test says so")]

mod cameras;
#[cfg(unix)]
mod common;
mod feed;
mod inputs;
mod masks;
mod model;
mod real_data;
mod refused;
mod scenes;
mod sfm;
mod stage;
mod stereo;
