//! Images in sRGB and in linear RGB, as different types.

use std::fmt::Debug;

/// A colour space, with the type of its channels.
pub trait ColorSpace: Clone + Debug + PartialEq {
    /// Type of one channel.
    type Channel: Copy + Debug + Default + PartialEq + Send + Sync;
}

/// Display-referred sRGB, 8 bits a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Srgb;

/// Linear RGB, f32 a channel. 1 is the white of sRGB.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Linear;

impl ColorSpace for Srgb {
    type Channel = u8;
}

impl ColorSpace for Linear {
    type Channel = f32;
}

/// An image of three channels, rows from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Image<S: ColorSpace> {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `[height * width]`, row-major.
    pub pixels: Vec<[S::Channel; 3]>,
}

impl<S: ColorSpace> Image<S> {
    /// Returns the image whose pixels a function of (column, row) gives.
    pub fn from_fn(width: u32, height: u32, mut pixel: impl FnMut(u32, u32) -> [S::Channel; 3]) -> Self {
        let pixels = (0..height).flat_map(|row| (0..width).map(move |column| (column, row)));
        Self {
            width,
            height,
            pixels: pixels.map(|(column, row)| pixel(column, row)).collect(),
        }
    }

    /// Returns the pixel at (column, row).
    ///
    /// # Panics
    /// Outside the image.
    pub fn at(&self, column: u32, row: u32) -> [S::Channel; 3] {
        self.pixels[row as usize * self.width as usize + column as usize]
    }
}

impl Image<Srgb> {
    /// Returns the image reduced by an integer factor: exact box means of 8-bit sRGB, rounded half up.
    ///
    /// Columns and rows that do not fill a box are left out at the right and bottom edge.
    pub fn box_reduced(&self, factor: u32) -> Self {
        let factor = factor.max(1);
        Self {
            width: self.width / factor,
            height: self.height / factor,
            pixels: box_means(&self.pixels, self.width, factor),
        }
    }
}

/// Returns the means of boxes of `factor` x `factor` pixels, rounded half up. See [`Image::box_reduced`].
pub(crate) fn box_means<const N: usize>(pixels: &[[u8; N]], width: u32, factor: u32) -> Vec<[u8; N]> {
    if factor <= 1 {
        return pixels.to_vec();
    }
    let (width, side, area) = (width as usize, factor as usize, factor * factor);
    let (columns, rows) = (width / side, pixels.len() / width.max(1) / side);
    let mut means = Vec::with_capacity(columns * rows);
    let mut sums = vec![[0_u32; N]; columns];
    let lines = pixels.chunks_exact(width.max(1));
    for (row, line) in lines.take(rows * side).enumerate() {
        for (sum, pixels) in sums.iter_mut().zip(line.chunks_exact(side)) {
            for pixel in pixels {
                sum.iter_mut()
                    .zip(pixel)
                    .for_each(|(sum, channel)| *sum += u32::from(*channel));
            }
        }
        if (row + 1) % side == 0 {
            means.extend(
                sums.iter()
                    .map(|sum| sum.map(|sum| ((sum + area / 2) / area) as u8)),
            );
            sums.fill([0; N]);
        }
    }
    means
}
