//! Decoding of photos, and encoding as PNG.

mod decode;
mod decoded;
mod foreign;
mod jpeg;
mod other;
mod scan;
mod strips;
mod tagged;
#[cfg(test)]
mod tests;
mod tones;

pub(crate) use decoded::damaged;
pub use decoded::{DecodeError, MAX_DECODED_BYTES, Photo, TooLarge, encode_png};
