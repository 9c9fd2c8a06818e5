//! Decoding of photos, and encoding as PNG.

mod decode;
mod decoded;
mod jpeg;
mod other;
mod scan;
#[cfg(test)]
mod tests;

pub(crate) use decoded::damaged;
pub use decoded::{DecodeError, Photo, encode_png};
