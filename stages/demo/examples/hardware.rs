//! Writes photos of the built-in Mars clean, and with a part of the rover in the picture and masks of it:
//! `cargo run --release -p marf-demo --example hardware -- DIR [SOLS]`, then a pipeline like `pipelines/folder.toml` on `DIR/clean` and on
//! `DIR/hardware`. Without `DIR/hardware/masks` the rover is learnt as if it stood on Mars.

use std::{error::Error, fs, path::PathBuf};

use image::{ImageFormat, Rgb, RgbImage};
use marf_demo::{Demo, DemoOptions};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("name a folder to write into")?);
    let sols: u32 = arguments.next().map_or(Ok(2), |text| text.parse())?;
    let demo = Demo::new(DemoOptions::default())?;
    for part in ["clean/images", "hardware/images", "hardware/masks"] {
        fs::create_dir_all(folder.join(part))?;
    }
    for sol in 1..=sols {
        let good: Vec<String> = demo
            .ground_truth(sol)?
            .photos
            .into_iter()
            .map(|photo| photo.file)
            .collect();
        for file in demo.files(sol, &|_, _| {}, &|| false)? {
            if !good.contains(&file.name) {
                continue;
            }
            fs::write(folder.join("clean/images").join(&file.name), &file.bytes)?;
            let mut photo = image::load_from_memory(&file.bytes)?.to_rgb8();
            let mask = planted(&mut photo);
            photo.save_with_format(folder.join("hardware/images").join(&file.name), ImageFormat::Png)?;
            mask.save_with_format(folder.join("hardware/masks").join(&file.name), ImageFormat::Png)?;
        }
    }
    Ok(())
}

/// Draws a deck along the lower edge and an arm across it, which stand still in the picture while the camera moves; returns the mask.
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
