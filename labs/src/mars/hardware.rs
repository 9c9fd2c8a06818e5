//! `hardware`: photos of the built-in Mars clean, and with a part of the rover in the picture.

use std::{fs, path::Path};

use image::{ImageFormat, Rgb, RgbImage};
use marf_demo::{Demo, DemoOptions};

use crate::output::Result;

/// Writes the good photos of the first sols, clean and with hardware, and masks of it.
pub fn hardware(dir: &Path, sols: u32) -> Result {
    let demo = Demo::new(DemoOptions::default())?;
    for part in ["clean/images", "hardware/images", "hardware/masks"] {
        fs::create_dir_all(dir.join(part))?;
    }
    for sol in 1..=sols {
        let good = demo.ground_truth(sol)?.photos;
        for file in demo.files(sol, &|_, _| {}, &|| false)? {
            if !good.iter().any(|photo| photo.file == file.name) {
                continue;
            }
            fs::write(dir.join("clean/images").join(&file.name), &file.bytes)?;
            let mut photo = image::load_from_memory(&file.bytes)?.to_rgb8();
            let mask = planted(&mut photo);
            photo.save_with_format(dir.join("hardware/images").join(&file.name), ImageFormat::Png)?;
            mask.save_with_format(dir.join("hardware/masks").join(&file.name), ImageFormat::Png)?;
        }
    }
    Ok(())
}

/// Draws a deck along the lower edge and an arm across it, at the same place in every picture while the camera moves. Returns the
/// mask.
fn planted(photo: &mut RgbImage) -> RgbImage {
    let (width, height) = (f64::from(photo.width()), f64::from(photo.height()));
    let mut mask = RgbImage::from_pixel(photo.width(), photo.height(), Rgb([255; 3]));
    for (column, row, pixel) in photo.enumerate_pixels_mut() {
        let (x, y) = (f64::from(column) / width, f64::from(row) / height);
        let deck = y > 0.9 + 0.05 * x;
        // The arm is a band of 0.06 along a line from (0.2, 1) to (0.45, 0.55).
        let along = (y - 1.0) / -0.45;
        let arm = (0.0..=1.0).contains(&along) && (x - (0.2 + 0.25 * along)).abs() < 0.03;
        if deck || arm {
            let shade = (120.0 + 80.0 * ((30.0 * (x + y)) as i64 % 2) as f64) as u8;
            *pixel = Rgb([shade, shade, shade.saturating_sub(10)]);
            mask.put_pixel(column, row, Rgb([0; 3]));
        }
    }
    mask
}
