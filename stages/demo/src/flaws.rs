//! The defects that are put into photos.

use marf_scene::{Image, Srgb};

use super::math::{cell, cell_bits, noise2, smoothstep};

/// Number of box blurs, one after another: three are close to a Gaussian.
const PASSES: usize = 3;
/// Half width of each box at 640 pixels: sigma² = 3 (7² - 1) / 12 = 12, sigma 3.5 pixels.
const BOX: usize = 3;
/// Length of the motion blur at 640 pixels.
const SMEAR: u32 = 29;

pub fn luma(pixel: [u8; 3]) -> u8 {
    let [r, g, b] = pixel.map(u32::from);
    ((77 * r + 150 * g + 29 * b + 128) >> 8) as u8
}

pub fn mapped(image: &Image<Srgb>, change: impl Fn([u8; 3]) -> [u8; 3]) -> Image<Srgb> {
    Image::from_fn(image.width, image.height, |x, y| change(image.at(x, y)))
}

/// Returns the photo as through a narrow filter: one band, tinted as browse products are.
pub fn narrow_band(image: &Image<Srgb>, filter: u8) -> Image<Srgb> {
    let (band, tint) = match filter {
        1 => (0, [258, 150, 96]),
        _ => (1, [118, 290, 170]),
    };
    mapped(image, |pixel| {
        tint.map(|share: u32| ((u32::from(pixel[band]) * share) >> 8).min(255) as u8)
    })
}

pub fn defocused(image: &Image<Srgb>) -> Image<Srgb> {
    let radius = (BOX * image.width as usize / 640).max(1) as i64;
    let along_x: Vec<[i64; 2]> = (-radius..=radius).map(|k| [k, 0]).collect();
    let along_y: Vec<[i64; 2]> = (-radius..=radius).map(|k| [0, k]).collect();
    (0..PASSES).fold(image.clone(), |image, _| mean(&mean(&image, &along_x), &along_y))
}

/// Blurs along a line that descends one pixel in three.
pub fn smeared(image: &Image<Srgb>) -> Image<Srgb> {
    let length = i64::from((SMEAR * image.width / 640).max(3));
    let line: Vec<[i64; 2]> = (0..length).map(|k| [k, k / 3]).collect();
    mean(image, &line)
}

/// Returns the mean of the pixels at these offsets. The border is repeated.
fn mean(image: &Image<Srgb>, offsets: &[[i64; 2]]) -> Image<Srgb> {
    let count = offsets.len() as u32;
    let within = |at: i64, side: u32| at.clamp(0, i64::from(side) - 1) as u32;
    Image::from_fn(image.width, image.height, |x, y| {
        let mut sum = [0_u32; 3];
        for [dx, dy] in offsets {
            let (x, y) = (i64::from(x) + dx, i64::from(y) + dy);
            let pixel = image.at(within(x, image.width), within(y, image.height));
            for (sum, channel) in sum.iter_mut().zip(pixel) {
                *sum += u32::from(channel);
            }
        }
        sum.map(|sum| ((sum + count / 2) / count) as u8)
    })
}

pub fn noise(width: u32, height: u32, salt: u32) -> Image<Srgb> {
    Image::from_fn(width, height, |x, y| {
        let bits = cell_bits(i64::from(x), i64::from(y), salt);
        [bits as u8, (bits >> 8) as u8, (bits >> 16) as u8]
    })
}

pub fn colour_blocks(width: u32, height: u32, salt: u32) -> Image<Srgb> {
    let side = (width / 20).max(1);
    Image::from_fn(width, height, |x, y| {
        let block = cell_bits(i64::from(x / side), i64::from(y / side), salt);
        let grain = cell_bits(i64::from(x), i64::from(y), salt ^ 1);
        std::array::from_fn(|k| {
            let ripple = (grain >> (8 * k) & 15) as u8;
            if block >> k & 1 == 1 { 255 - ripple } else { ripple }
        })
    })
}

/// Returns a frame taken in the dark: black with a few hot pixels.
pub fn dark(width: u32, height: u32, salt: u32) -> Image<Srgb> {
    Image::from_fn(width, height, |x, y| {
        let hot = cell(i64::from(x), i64::from(y), salt);
        if hot > 0.9996 { [90, 84, 80] } else { [3, 3, 4] }
    })
}

/// Returns the rover's deck from above: white plates, seams, screws, cables, a round target, dust.
pub fn deck(width: u32, height: u32, salt: u32) -> Image<Srgb> {
    let unit = 10.0 / f64::from(width);
    Image::from_fn(width, height, |column, row| {
        let (x, y) = (f64::from(column) * unit, f64::from(row) * unit);
        let (u, v) = (x + 0.22 * y, y - 0.08 * x);
        let grain = cell(i64::from(column), i64::from(row), salt);
        let dust =
            0.5 + 0.5 * noise2(u * 1.3, v * 1.3, salt ^ 1).0 + 0.15 * noise2(u * 9.0, v * 9.0, salt ^ 2).0;
        let film = 0.25 * smoothstep(0.2, 1.0, dust);
        let light = plate(u, v, salt) + 0.05 * (grain - 0.5);
        let tint = [1.0, 0.985 - 0.25 * film, 0.95 - 0.55 * film];
        tint.map(|share| (255.0 * (light - 0.12 * film) * share).clamp(0.0, 255.0) as u8)
    })
}

/// Returns the brightness of the deck, 0 to 1.
fn plate(u: f64, v: f64, salt: u32) -> f64 {
    let (i, j) = ((u / 2.6).floor(), (v / 1.9).floor());
    let (a, b) = (u - 2.6 * i, v - 1.9 * j);
    let mut light = 0.86 + 0.10 * cell(i as i64, j as i64, salt ^ 3);
    let seam = a.min(2.6 - a).min(b).min(1.9 - b);
    light *= 0.45 + 0.55 * smoothstep(0.015, 0.045, seam);
    for (x, y) in [(0.18, 0.18), (2.42, 0.18), (0.18, 1.72), (2.42, 1.72)] {
        let screw = ((a - x) * (a - x) + (b - y) * (b - y)).sqrt();
        light *= 0.55 + 0.45 * smoothstep(0.05, 0.07, screw);
    }
    let target = ((u - 6.1) * (u - 6.1) + (v - 3.2) * (v - 3.2)).sqrt();
    if target < 0.9 {
        light = if (target * 5.0) as i64 % 2 == 0 {
            0.97
        } else {
            0.20
        };
    }
    let cable = (v - 5.4 - 0.35 * noise2(u * 0.7, 0.5, salt ^ 4).0).abs();
    light * (0.12 + 0.88 * smoothstep(0.10, 0.13, cable))
}
