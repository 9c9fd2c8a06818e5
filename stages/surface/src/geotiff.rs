//! Maps as GeoTIFF (OGC 19-008r4), which programs for maps read.
//!
//! Pixels are areas, rows run from the top. The coordinates are those of a local frame in metres, without
//! ellipsoid and projection. The citation holds the name of the frame. Pixels without a value are NaN (float)
//! or transparent (colour).

use std::io::Cursor;

use marf_schema::surface::MapReport;
use tiff::TiffError;
use tiff::encoder::colortype::{Gray32Float, RGB8};
use tiff::encoder::{Compression, DeflateLevel, DirectoryEncoder, TiffEncoder, TiffKindStandard};
use tiff::tags::{ExtraSamples, Tag};

/// GDAL's tag for what XML says of the bands.
const GDAL_METADATA: Tag = Tag::Unknown(42112);
/// Keys of the directory and their values (OGC 19-008r4, tables 3 and B.1).
const MODEL_TYPE: u16 = 1024;
const RASTER_TYPE: u16 = 1025;
const CITATION: u16 = 1026;
const LINEAR_UNITS: u16 = 3076;
const USER_DEFINED: u16 = 32_767;
const PIXEL_IS_AREA: u16 = 1;
const METRE: u16 = 9001;

/// Returns a map of one quantity. NaN where there is no value.
///
/// - `values`: `[rows * columns]`, from the top. `quantity`: what they are, in words. `unit`: as GDAL names it, `m`.
///
/// # Errors
/// A file beyond 4 GB.
pub fn quantity(map: &MapReport, values: &[f32], quantity: &str, unit: &str) -> Result<Vec<u8>, TiffError> {
    let mut file = Cursor::new(Vec::new());
    let mut encoder = encoder(&mut file)?;
    let mut image = encoder.new_image::<Gray32Float>(map.columns, map.rows)?;
    let items = [
        item(quantity, "name=\"DESCRIPTION\" sample=\"0\" role=\"description\""),
        item(unit, "name=\"UNITTYPE\" sample=\"0\" role=\"unittype\""),
    ];
    place(image.encoder(), map, &items.concat())?;
    image.encoder().write_tag(Tag::GdalNodata, "nan")?;
    image.write_data(values)?;
    Ok(file.into_inner())
}

/// Returns a map of colours with an alpha band of 0 and 255.
///
/// # Errors
/// As [`quantity`].
pub fn colors(map: &MapReport, pixels: &[[u8; 4]]) -> Result<Vec<u8>, TiffError> {
    let mut file = Cursor::new(Vec::new());
    let mut encoder = encoder(&mut file)?;
    let mut image = encoder.new_image::<RGB8>(map.columns, map.rows)?;
    image.extra_samples(&[ExtraSamples::UnassociatedAlpha])?;
    // The encoder counts the samples of the colour type alone.
    image.encoder().write_tag(Tag::SamplesPerPixel, 4_u16)?;
    image.encoder().write_tag(Tag::BitsPerSample, &[8_u16; 4][..])?;
    image.encoder().write_tag(Tag::SampleFormat, &[1_u16; 4][..])?;
    place(image.encoder(), map, "")?;
    image.write_data(pixels.as_flattened())?;
    Ok(file.into_inner())
}

type Encoder<'a> = TiffEncoder<&'a mut Cursor<Vec<u8>>>;

fn encoder(file: &mut Cursor<Vec<u8>>) -> Result<Encoder<'_>, TiffError> {
    Ok(TiffEncoder::new(file)?.with_compression(Compression::Deflate(DeflateLevel::Balanced)))
}

/// Writes where the map lies: the corner of the first pixel, the width of a pixel, the frame.
fn place(
    directory: &mut DirectoryEncoder<'_, &mut Cursor<Vec<u8>>, TiffKindStandard>,
    map: &MapReport,
    items: &str,
) -> Result<(), TiffError> {
    let half = map.pixel_m / 2.0;
    let corner = [map.first_m[0] - half, map.first_m[1] + half];
    directory.write_tag(Tag::ModelPixelScaleTag, &[map.pixel_m, map.pixel_m, 0.0][..])?;
    directory.write_tag(
        Tag::ModelTiepointTag,
        &[0.0, 0.0, 0.0, corner[0], corner[1], 0.0][..],
    )?;
    // A GeoTIFF's texts are ASCII, and each ends with `|`.
    let name = format!("metres from the origin of {}|", ascii(&map.origin));
    let header = [1, 1, 0, 4];
    let keys = [
        [MODEL_TYPE, 0, 1, USER_DEFINED],
        [RASTER_TYPE, 0, 1, PIXEL_IS_AREA],
        [CITATION, Tag::GeoAsciiParamsTag.to_u16(), name.len() as u16, 0],
        [LINEAR_UNITS, 0, 1, METRE],
    ];
    let directory_of_keys: Vec<u16> = header.into_iter().chain(keys.into_iter().flatten()).collect();
    directory.write_tag(Tag::GeoKeyDirectoryTag, &directory_of_keys[..])?;
    directory.write_tag(Tag::GeoAsciiParamsTag, name.as_str())?;
    let [right, top, up] = map.axes;
    let axes = item(
        &format!("right {right:?}, top {top:?}, up {up:?}"),
        "name=\"AXES_IN_THE_SCENE\"",
    );
    let metadata = format!("<GDALMetadata>{items}{axes}</GDALMetadata>");
    directory.write_tag(GDAL_METADATA, metadata.as_str())
}

fn item(text: &str, attributes: &str) -> String {
    let text = ascii(text)
        .replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;");
    format!("<Item {attributes}>{text}</Item>")
}

fn ascii(text: &str) -> String {
    text.chars()
        .map(|char| if char.is_ascii() && char != '|' { char } else { '?' })
        .collect()
}
