//! Which photos to compare, and which of their features match.
//!
//! Pure functions of descriptors in integers: the same matches on any instruction set, with any number of threads.

mod match_pair;
mod nearest;
mod pairs;

pub use match_pair::match_pair;
pub use pairs::{Samples, exhaustive, most_similar, sequential};

#[cfg(test)]
mod tests;
