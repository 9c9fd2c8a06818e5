//! Writes a descent for `marf bench train`: `cargo run --release -p marf-demo --example descent -- DIR [PHOTOS [SIDE]]`.

use std::{error::Error, fs, path::PathBuf};

use marf_demo::{Demo, DemoOptions};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("name a folder to write into")?);
    let mut number = |default: u32| arguments.next().map_or(Ok(default), |text| text.parse());
    let (photos, side) = (number(64)?, number(320)?);
    let demo = Demo::new(DemoOptions {
        width_px: side,
        height_px: side,
        seed: 1,
    })?;
    fs::create_dir_all(folder.join("images"))?;
    for file in demo.descent(photos, &|| false)? {
        fs::write(folder.join(&file.name), &file.bytes)?;
    }
    Ok(())
}
