//! Margins of photos, which show nothing: black columns of an instrument, and edges that a resampling repeats.

use marf_scene::{Image, Srgb};

use crate::raster::Raster;

/// Fewest pixels of a margin, counted from the border.
const LEAST: usize = 3;
/// A pixel with no channel above this is black.
const BLACK: u8 = 8;
/// Pixels next to a margin that an interpolation mixes with it.
const MIXED: usize = 2;

/// Returns which pixels of a photo show something.
///
/// A margin is what repeats, from the border on, the last pixel of its row or column, or is black like it. Saturated sky at the border is such a
/// margin, too: it has no texture.
pub(crate) fn usable(photo: &Image<Srgb>) -> Raster<bool> {
    let (width, height) = (photo.width as usize, photo.height as usize);
    let mut usable = Raster::filled(width, height, true);
    for y in 0..height {
        let at = |x: usize| y * width + x;
        mark(&mut usable, photo, (0..width).map(at));
        mark(&mut usable, photo, (0..width).rev().map(at));
    }
    for x in 0..width {
        let at = |y: usize| y * width + x;
        mark(&mut usable, photo, (0..height).map(at));
        mark(&mut usable, photo, (0..height).rev().map(at));
    }
    usable.eroded(MIXED, MIXED)
}

/// Marks the margin at the beginning of a line of pixels.
fn mark(usable: &mut Raster<bool>, photo: &Image<Srgb>, line: impl Iterator<Item = usize> + Clone) {
    let Some(border) = line.clone().next().map(|first| photo.pixels[first]) else {
        return;
    };
    let is_black = |pixel: [u8; 3]| pixel.iter().all(|channel| *channel <= BLACK);
    let repeats = |pixel: [u8; 3]| pixel == border || (is_black(pixel) && is_black(border));
    let margin = line.clone().take_while(|at| repeats(photo.pixels[*at])).count();
    if margin >= LEAST {
        line.take(margin).for_each(|at| usable.values[at] = false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn black_and_repeated_borders_are_margins_and_texture_is_not() {
        // Four black columns with noise, texture, and a right border that repeats its last column three times.
        let photo = Image::from_fn(20, 12, |x, y| {
            let noise = ((x * 7 + y * 13) % 5) as u8;
            if x < 4 {
                return [noise, 0, 3];
            }
            let x = x.min(17);
            [(50 + 37 * ((x + 3 * y) % 5)) as u8, 90, 90]
        });
        let usable = usable(&photo);
        for y in 0..12 {
            let row: Vec<usize> = (0..20).filter(|x| usable.at(*x, y)).collect();
            // Two more pixels on each side are mixed with the margin.
            assert_eq!(row, (6..15).collect::<Vec<_>>(), "{y}");
        }
    }

    #[test]
    fn a_constant_photo_is_all_margin_and_a_textured_one_has_none() {
        let count = |photo: &Image<Srgb>| usable(photo).values.iter().filter(|usable| **usable).count();
        assert_eq!(count(&Image::from_fn(9, 7, |_, _| [255; 3])), 0);
        assert_eq!(
            count(&Image::from_fn(9, 7, |x, y| [(20 + 11 * x + 5 * y) as u8; 3])),
            63
        );
    }
}
