//! Pictures for people: colour maps with a printed scale, text, animations.

mod font;
mod gif;
mod map;
mod palette;

pub use font::{draw_text, text_width_px};
pub use gif::encode_gif;
pub use map::{Scale, beside, draw_map, nice_top};
pub use palette::Palette;
