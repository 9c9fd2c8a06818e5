//! Drawn pictures: colour maps with a scale, text.

mod font;
mod map;
mod palette;

pub use font::{draw_text, text_width_px};
pub use map::{ColorScale, draw_map, draw_titled, round_upper_limit, side_by_side};
pub use palette::Palette;
