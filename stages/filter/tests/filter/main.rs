//! The filters without an engine: one program, which the compiler links once.
#![allow(clippy::unwrap_used, reason = "a fixture that is wrong should stop the test")]
#![allow(clippy::print_stdout, reason = "a test says when it is skipped")]

#[path = "../common/mod.rs"]
mod common;
mod comparisons;
mod duplicates;
mod real_data;
mod reasons;
mod rules;
mod table;
