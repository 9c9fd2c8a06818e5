//! Values on a grid of pixels, and pictures.

/// Values on a grid of `width` x `height` pixels, row by row from the top-left corner.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Raster<T> {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height x width]`.
    pub values: Vec<T>,
}

impl<T: Copy> Raster<T> {
    /// Returns a raster with one value everywhere.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self {
            width,
            height,
            values: vec![value; width * height],
        }
    }

    /// Returns a raster of the same size as `other` with one value everywhere.
    pub(crate) fn like<U>(other: &Raster<U>, value: T) -> Self {
        Self {
            width: other.width,
            height: other.height,
            values: vec![value; other.values.len()],
        }
    }

    /// Returns the value of a pixel inside.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> T {
        self.values[y * self.width + x]
    }

    /// Returns a row.
    #[inline]
    pub fn row(&self, y: usize) -> &[T] {
        &self.values[y * self.width..(y + 1) * self.width]
    }

    /// Returns the value of the nearest pixel inside.
    #[inline]
    pub(crate) fn clamped(&self, x: isize, y: isize) -> T {
        self.at(
            x.clamp(0, self.width as isize - 1) as usize,
            y.clamp(0, self.height as isize - 1) as usize,
        )
    }

    /// Returns the raster with `margin` pixels more on each side, which repeat the nearest pixel inside.
    pub(crate) fn padded(&self, margin: usize) -> Self {
        let (width, height) = (self.width + 2 * margin, self.height + 2 * margin);
        let mut values = Vec::with_capacity(width * height);
        for y in 0..height {
            let row = self.row(y.saturating_sub(margin).min(self.height - 1));
            values.resize(values.len() + margin, row[0]);
            values.extend_from_slice(row);
            values.resize(values.len() + margin, row[self.width - 1]);
        }
        Self {
            width,
            height,
            values,
        }
    }
}

impl Raster<bool> {
    /// Returns where all pixels at most so many columns and rows away are `true`. What is outside does not count.
    pub(crate) fn eroded(&self, columns: usize, rows: usize) -> Self {
        let (width, height) = (self.width, self.height);
        let mut across = self.clone();
        let mut out = self.clone();
        for y in 0..height {
            for x in (0..width).filter(|x| !self.at(*x, y)) {
                let near = x.saturating_sub(columns)..(x + columns + 1).min(width);
                across.values[y * width..][near].fill(false);
            }
        }
        for y in 0..height {
            for near in y.saturating_sub(rows)..(y + rows + 1).min(height) {
                let (out, across) = (&mut out.values[near * width..][..width], across.row(y));
                out.iter_mut()
                    .zip(across)
                    .for_each(|(out, across)| *out &= across);
            }
        }
        out
    }
}

/// A rectified picture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Brightness, 0 to 255. A gain or an offset between the two pictures of a pair does no harm.
    pub grey: Raster<u8>,
    /// Whether a pixel takes part: `false` for the rover's own parts, burnt-out pixels and what is outside the photo.
    pub usable: Raster<bool>,
}

impl Picture {
    /// Returns a picture in which all pixels take part.
    pub fn new(grey: Raster<u8>) -> Self {
        let usable = Raster::like(&grey, true);
        Self { grey, usable }
    }

    /// Returns the picture at half the size, rounded up: means of 2 x 2 pixels, usable where all of them are.
    pub(crate) fn halved(&self) -> Self {
        let (width, height) = (self.grey.width.div_ceil(2), self.grey.height.div_ceil(2));
        let mut half = Self::new(Raster::filled(width, height, 0));
        for y in 0..height {
            for x in 0..width {
                let mut sum = 2;
                let mut usable = true;
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let (sx, sy) = ((2 * x + dx) as isize, (2 * y + dy) as isize);
                    sum += u16::from(self.grey.clamped(sx, sy));
                    usable &= self.usable.clamped(sx, sy);
                }
                half.grey.values[y * width + x] = (sum / 4) as u8;
                half.usable.values[y * width + x] = usable;
            }
        }
        half
    }
}
