//! Drawn pictures: colour maps with a scale, text, and measured quantities as pictures of 16 bits.

mod font;
mod map;
mod palette;
pub mod png16;

pub use font::{draw_text, text_width_px};
pub use map::{
    ColorScale, DEPTH_DECADES, DEPTH_SPREAD_DECADES, draw_map, draw_titled, quantile, round_upper_limit,
    side_by_side,
};
pub use palette::Palette;
