//! Trades of time for quality.

mod base;
mod figures;
mod knobs;
mod measured;
mod request;

pub use request::{TradeRequest, trade};
