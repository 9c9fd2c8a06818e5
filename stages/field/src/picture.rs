use marf_scene::{Image, Srgb};

/// A rendered photo, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Render {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `[height * width]`, sRGB in [0, 1].
    pub rgb: Vec<[f32; 3]>,
    /// `[height * width]`, share of the ray that met matter, in [0, 1].
    pub opacity: Vec<f32>,
    /// `[height * width]`, expected distance along the ray, world units. 0 where opacity is 0. Never NaN.
    pub depth: Vec<f32>,
}

impl Render {
    /// Returns a black and empty picture.
    pub fn empty(width: u32, height: u32) -> Self {
        let pixels = width as usize * height as usize;
        Self {
            width,
            height,
            rgb: vec![[0.0; 3]; pixels],
            opacity: vec![0.0; pixels],
            depth: vec![0.0; pixels],
        }
    }

    /// Returns the colours rounded to 8 bits.
    pub fn to_image(&self) -> Image<Srgb> {
        let pixels = self.rgb.iter();
        let round = |value: f32| (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        Image {
            width: self.width,
            height: self.height,
            pixels: pixels.map(|rgb| rgb.map(round)).collect(),
        }
    }
}
