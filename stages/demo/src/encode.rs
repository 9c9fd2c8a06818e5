//! The images of products as files.

use std::fmt::Display;

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
    encoded(product, image, 3, marf_scene::encode_png(image))
}

fn mono_png(product: &Product, image: &Image<Srgb>) -> Result<EncodedImage, DemoError> {
    let luma: Vec<u8> = image.pixels.iter().map(|&pixel| flaws::luma(pixel)).collect();
    let mut bytes = Vec::new();
    let encoder = PngEncoder::new(&mut bytes);
    let written = encoder.write_image(&luma, image.width, image.height, ExtendedColorType::L8);
    encoded(product, image, 1, written.map(|()| bytes))
}

fn jpeg(product: &Product, image: &Image<Srgb>, quality: u8) -> Result<EncodedImage, DemoError> {
    encoded(product, image, 3, marf_scene::encode_jpeg(image, quality))
}

fn encoded<E: Display>(
    product: &Product,
    image: &Image<Srgb>,
    bands: u32,
    bytes: Result<Vec<u8>, E>,
) -> Result<EncodedImage, DemoError> {
    Ok(EncodedImage {
        width: image.width,
        height: image.height,
        bands,
        bytes: bytes.map_err(|error| DemoError::encode(product.file(), error))?,
    })
}
