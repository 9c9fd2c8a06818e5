//! Small photos made for the tests, and a run of one filter without an engine.
#![allow(dead_code, reason = "each test binary uses its own part")]
#![allow(
    clippy::unwrap_used,
    reason = "helpers of tests: a fixture that is wrong should stop the test"
)]

use std::collections::BTreeMap;

use image::{DynamicImage, ExtendedColorType, ImageEncoder, ImageFormat};
use marf_cache::manifest::Row;
use marf_filter::STAGES;
use marf_scene::{Image, Photo, PhotoFacts, Srgb, encode_png};
use marf_stage::{Measure, Measured, Stage, StageDef, Verdict, Work, harness::Harness};
use serde_json::{Value, json};

/// Returns a value of [0, 255] that looks random, the same everywhere.
pub fn scatter(x: u32, y: u32, seed: u32) -> u8 {
    let mut state =
        x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77) ^ seed.wrapping_mul(0xc2b2_ae3d);
    state = (state ^ (state >> 15)).wrapping_mul(0x2c1b_3c6d);
    state = (state ^ (state >> 12)).wrapping_mul(0x297a_2d39);
    (state >> 24) as u8
}

/// Values of a lattice of `cell` pixels, linear in between.
fn waves(x: u32, y: u32, cell: u32, seed: u32) -> f64 {
    let (column, row) = (x / cell, y / cell);
    let (u, v) = (
        f64::from(x % cell) / f64::from(cell),
        f64::from(y % cell) / f64::from(cell),
    );
    let at = |dx: u32, dy: u32| f64::from(scatter(column + dx, row + dy, seed));
    (at(0, 0) * (1.0 - u) + at(1, 0) * u) * (1.0 - v) + (at(0, 1) * (1.0 - u) + at(1, 1) * u) * v
}

/// A sharp, coloured ground of 320 x 240 pixels: structures of 2 to 64 pixels; another seed is another place.
pub fn ground(seed: u32) -> Image<Srgb> {
    Image::from_fn(320, 240, |x, y| {
        let octaves = [
            (64, 0.35),
            (32, 0.25),
            (16, 0.17),
            (8, 0.11),
            (4, 0.07),
            (2, 0.05),
        ];
        let sum: f64 = octaves
            .iter()
            .map(|(cell, part)| part * waves(x, y, *cell, seed + cell))
            .sum();
        let tint = waves(x, y, 32, seed + 1000) / 255.0;
        let shade = 30.0 + 0.7 * sum;
        [shade, shade * (0.6 + 0.2 * tint), shade * (0.25 + 0.35 * tint)].map(|value| value as u8)
    })
}

/// Applies a function to every pixel.
pub fn recoloured(image: &Image<Srgb>, color: impl Fn([u8; 3]) -> [u8; 3]) -> Image<Srgb> {
    Image::from_fn(image.width, image.height, |x, y| color(image.at(x, y)))
}

/// One band seen through a tinted filter.
pub fn narrow(image: &Image<Srgb>, band: usize, tint: [f64; 3]) -> Image<Srgb> {
    recoloured(image, |pixel| {
        tint.map(|tint| (tint * f64::from(pixel[band])).round() as u8)
    })
}

/// Box mean over `length` pixels along the rows.
pub fn smeared(image: &Image<Srgb>, length: u32) -> Image<Srgb> {
    Image::from_fn(image.width, image.height, |x, y| {
        [0, 1, 2].map(|band| {
            let near = (0..length).map(|step| (x + step).min(image.width - 1));
            (near.map(|x| u32::from(image.at(x, y)[band])).sum::<u32>() / length) as u8
        })
    })
}

pub fn png(image: &Image<Srgb>) -> Vec<u8> {
    encode_png(image).unwrap()
}

pub fn dynamic(image: &Image<Srgb>) -> DynamicImage {
    let bytes = image.pixels.as_flattened().to_vec();
    image::RgbImage::from_raw(image.width, image.height, bytes)
        .unwrap()
        .into()
}

pub fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

pub fn jpeg(image: &DynamicImage, quality: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    let rgb = image.to_rgb8();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, quality)
        .write_image(&rgb, rgb.width(), rgb.height(), ExtendedColorType::Rgb8)
        .unwrap();
    bytes
}

/// Puts an EXIF segment with this orientation behind the start marker of a JPEG.
pub fn with_orientation(jpeg: &[u8], orientation: u8) -> Vec<u8> {
    let mut exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
    exif.extend([orientation, 0, 0, 0, 0, 0, 0]);
    let length = (exif.len() as u16 + 2).to_be_bytes();
    [&jpeg[..2], &[0xff, 0xe1], &length, &exif, &jpeg[2..]].concat()
}

/// A set of photos under test.
#[derive(Default)]
pub struct Photos {
    pub harness: Harness,
    pub rows: Vec<Row>,
}

impl Photos {
    pub fn add(&mut self, id: &str, bytes: &[u8]) -> &mut Self {
        self.add_with(id, bytes, |_| {})
    }

    /// Adds a photo with the facts an archive would give, changed by `change`.
    pub fn add_with(&mut self, id: &str, bytes: &[u8], change: impl FnOnce(&mut PhotoFacts)) -> &mut Self {
        let decoded = Photo::decode(bytes).ok();
        let (width, height) = decoded
            .as_ref()
            .map_or((0, 0), |photo| (photo.image.width, photo.image.height));
        let mut facts = PhotoFacts {
            file: format!("{id}.file"),
            size_bytes: bytes.len() as u64,
            width,
            height,
            bands: decoded.map_or(0, |photo| photo.bands),
            ..PhotoFacts::default()
        };
        change(&mut facts);
        let blobs = BTreeMap::from([("image".to_owned(), self.harness.put(bytes))]);
        self.rows.push(Row {
            id: id.to_owned(),
            blobs,
            facts: facts.to_json(),
        });
        self
    }

    pub fn measures(&self, stage: &dyn Stage) -> Vec<Vec<u8>> {
        let measure = measure_of(stage);
        self.rows
            .iter()
            .map(|row| measure.measure(&self.harness.ctx(), row).unwrap())
            .collect()
    }

    /// Runs one filter over all photos as one sol.
    pub fn judge(&self, name: &str, params: Value) -> BTreeMap<String, Verdict> {
        let stage = bind(name, params);
        let measures = self.measures(&*stage);
        let items: Vec<_> = (0..self.rows.len())
            .map(|at| item(0, &self.rows[at], &measures[at]))
            .collect();
        by_id(decide(&*stage, &items))
    }
}

pub fn item<'a>(shard: u32, row: &'a Row, measure: &'a [u8]) -> Measured<'a> {
    Measured { shard, row, measure }
}

pub fn by_id(verdicts: Vec<Verdict>) -> BTreeMap<String, Verdict> {
    verdicts
        .into_iter()
        .map(|verdict| (verdict.id.clone(), verdict))
        .collect()
}

pub fn stage(name: &str) -> &'static StageDef {
    STAGES.iter().find(|stage| stage.name == name).unwrap()
}

pub fn bind(name: &str, params: Value) -> Box<dyn Stage> {
    (stage(name).bind)(params).unwrap()
}

pub fn measure_of(stage: &dyn Stage) -> &dyn Measure {
    match stage.work() {
        Work::Map(map) => map,
        Work::Fold(fold) => fold,
        _ => panic!("a filter is a map or a fold"),
    }
}

pub fn decide(stage: &dyn Stage, items: &[Measured<'_>]) -> Vec<Verdict> {
    match stage.work() {
        Work::Map(map) => map.decide(items).unwrap(),
        Work::Fold(fold) => fold.fold(None, items).unwrap().1,
        _ => panic!("a filter is a map or a fold"),
    }
}

/// Six places, each once, and of some a flawed or copied companion.
pub fn mixed() -> Photos {
    let lost = ground(12);
    let mut photos = Photos::default();
    for seed in 0..6 {
        photos.add(&format!("place-{seed}"), &png(&ground(seed)));
    }
    photos
        .add("copy-of-1", &jpeg(&dynamic(&ground(1)), 80))
        .add("red-of-2", &png(&narrow(&ground(2), 0, [1.0, 0.55, 0.35])))
        .add("smeared", &png(&smeared(&ground(10), 15)))
        .add(
            "gray",
            &encoded(&dynamic(&ground(11)).to_luma8().into(), ImageFormat::Png),
        )
        .add(
            "half-black",
            &png(&Image::from_fn(320, 240, |x, y| {
                if y < 80 { lost.at(x, y) } else { [0; 3] }
            })),
        )
        .add("cut", &jpeg(&dynamic(&ground(13)), 90)[..9000]);
    photos
}

pub fn defaults() -> Value {
    json!({})
}
