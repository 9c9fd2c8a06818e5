//! `descent`: photos of a descent to the built-in Mars.

use std::path::Path;

use marf_demo::{Demo, DemoOptions};
use marf_run::files;

use crate::output::Result;

/// Writes the photos and their cameras into a folder.
pub fn descent(dir: &Path, photos: u32, side_px: u32) -> Result {
    let demo = Demo::new(DemoOptions {
        width_px: side_px,
        height_px: side_px,
        seed: 1,
    })?;
    for file in demo.descent(photos, &|| false)? {
        files::write(&dir.join(&file.name), &file.bytes)?;
    }
    Ok(())
}
