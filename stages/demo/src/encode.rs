//! The images of products as files.

use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use marf_scene::{Image, Srgb};

use super::{
    error::DemoError,
    flaws,
    plan::{self, FlawKind, Product},
};

/// An encoded image.
pub struct EncodedImage {
    pub width: u32,
    pub height: u32,
    /// 1 or 3.
    pub bands: u32,
    /// The file.
    pub bytes: Vec<u8>,
}

/// Returns the image of a product.
pub fn picture(product: &Product, photo: &Image<Srgb>, salt: u32) -> Result<EncodedImage, DemoError> {
    let (width, height) = (photo.width, photo.height);
    let image = match product.flaw {
        None | Some(FlawKind::ExactCopy) => return png(product, photo),
        Some(FlawKind::MonoCopy | FlawKind::Mono) => return mono_png(product, photo),
        Some(FlawKind::Reencoded) => return jpeg(product, photo, 75),
        Some(FlawKind::Truncated) => {
            let mut image = jpeg(product, photo, 92)?;
            image.bytes.truncate(image.bytes.len() / 2);
            return Ok(image);
        }
        Some(FlawKind::Thumbnail) => photo.box_reduced(plan::THUMBNAIL_FACTOR),
        Some(FlawKind::EqualBands) => flaws::mapped(photo, |pixel| [flaws::luma(pixel); 3]),
        Some(FlawKind::NarrowBand(filter)) => flaws::narrow_band(photo, filter),
        Some(FlawKind::Defocus) => flaws::defocused(photo),
        Some(FlawKind::Motion) => flaws::smeared(photo),
        Some(FlawKind::Noise) => flaws::noise(width, height, salt),
        Some(FlawKind::ColourBlocks) => flaws::colour_blocks(width, height, salt),
        Some(FlawKind::Deck) => flaws::deck(width, height, salt),
        Some(FlawKind::Dark) => flaws::dark(width, height, salt),
    };
    png(product, &image)
}

fn png(product: &Product, image: &Image<Srgb>) -> Result<EncodedImage, DemoError> {
    let bytes = marf_scene::encode_png(image).map_err(|error| failed(product, &error))?;
    Ok(encoded(image, 3, bytes))
}

fn mono_png(product: &Product, image: &Image<Srgb>) -> Result<EncodedImage, DemoError> {
    let luma: Vec<u8> = image.pixels.iter().map(|&pixel| flaws::luma(pixel)).collect();
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(&luma, image.width, image.height, ExtendedColorType::L8)
        .map_err(|error| failed(product, &error))?;
    Ok(encoded(image, 1, bytes))
}

fn jpeg(product: &Product, image: &Image<Srgb>, quality: u8) -> Result<EncodedImage, DemoError> {
    let bytes = marf_scene::encode_jpeg(image, quality).map_err(|error| failed(product, &error))?;
    Ok(encoded(image, 3, bytes))
}

fn encoded(image: &Image<Srgb>, bands: u32, bytes: Vec<u8>) -> EncodedImage {
    EncodedImage {
        width: image.width,
        height: image.height,
        bands,
        bytes,
    }
}

fn failed(product: &Product, error: &dyn std::fmt::Display) -> DemoError {
    DemoError::Encode {
        file: product.file(),
        message: error.to_string(),
    }
}
