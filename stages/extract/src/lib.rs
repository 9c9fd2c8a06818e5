//! Archives to photos and labels.

pub mod demo;
