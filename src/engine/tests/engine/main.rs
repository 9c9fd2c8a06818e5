//! The engine run on small stages: what runs, comparisons, failures, devices, and the checks of graphs.

#![allow(clippy::unwrap_used, reason = "a test that is set up wrong should stop")]

mod common;
mod compare;
mod damage;
mod devices;
mod earlier;
mod elsewhere;
mod faults;
mod graph;
mod rounds;
mod runs;
mod shared;
mod what_ran;
