//! Random search of the field's hyper-parameters.
//!
//! One stage, `tune`: it draws parameter sets from one seed, asks for a `train` node each, and keeps the best on
//! validation photos. Invariant: a draw depends on the seed, the trial's number and the key alone, so more trials,
//! or another key, leave the earlier draws as they were.

mod draw;
mod params;
mod reduce;

pub use draw::draw;
pub use params::Tune;
