//! Drawn pictures: colour maps with a scale, text, animations.

mod font;
mod gif;
mod map;
mod palette;

pub use font::{draw_text, text_width_px};
pub use gif::encode_gif;
pub use map::{ColorScale, draw_map, round_upper_limit, side_by_side};
pub use palette::Palette;
