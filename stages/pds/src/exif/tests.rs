use exif::experimental::Writer;
use exif::{Rational, Value};

use super::*;

/// A JPEG with these fields in its EXIF, as cameras write it.
fn jpeg(fields: &[(Tag, Value)]) -> Vec<u8> {
    let field = |(tag, value): &(Tag, Value)| Field {
        tag: *tag,
        ifd_num: In::PRIMARY,
        value: value.clone(),
    };
    let fields: Vec<Field> = fields.iter().map(field).collect();
    let mut tiff = Cursor::new(Vec::new());
    let mut writer = Writer::new();
    fields.iter().for_each(|field| writer.push_field(field));
    writer.write(&mut tiff, false).unwrap();
    let body = [b"Exif\0\0".as_slice(), &tiff.into_inner()].concat();
    let length = (body.len() as u16 + 2).to_be_bytes();
    [&[0xff, 0xd8, 0xff, 0xe1], length.as_slice(), &body, &[0xff, 0xd9]].concat()
}

fn short(tag: Tag, number: u16) -> (Tag, Value) {
    (tag, Value::Short(vec![number]))
}

fn ratio(tag: Tag, num: u32, denom: u32) -> (Tag, Value) {
    (tag, Value::Rational(vec![Rational { num, denom }]))
}

fn text(tag: Tag, text: &[u8]) -> (Tag, Value) {
    (tag, Value::Ascii(vec![text.to_vec()]))
}

fn focal(fields: &[(Tag, Value)]) -> Option<f64> {
    read(&jpeg(fields), 4000).focal_px
}

#[test]
fn the_film_equivalent_goes_before_the_sensor() {
    // 27 mm of 36 mm: three quarters of the longer side.
    let film = short(Tag::FocalLengthIn35mmFilm, 27);
    let sensor = [
        ratio(Tag::FocalLength, 5, 1),
        ratio(Tag::FocalPlaneXResolution, 10_000, 1),
    ];
    assert_eq!(focal(std::slice::from_ref(&film)), Some(3000.0));
    assert_eq!(focal(&[film, sensor[0].clone(), sensor[1].clone()]), Some(3000.0));
    // 0 means unknown: 5 mm x 10000 a inch / 25.4 mm.
    let unknown = short(Tag::FocalLengthIn35mmFilm, 0);
    let focal_px = focal(&[unknown, sensor[0].clone(), sensor[1].clone()]).unwrap();
    assert!((focal_px - 50_000.0 / 25.4).abs() < 1e-9, "{focal_px}");
    assert_eq!(
        focal(&sensor[..1]),
        None,
        "the size of a pixel is unknown without a resolution"
    );
}

#[test]
fn a_sensor_resolution_has_a_unit_and_is_of_the_photo_as_taken() {
    let with = |unit: u16, taken: u32| {
        focal(&[
            ratio(Tag::FocalLength, 50, 10),
            short(Tag::FocalPlaneResolutionUnit, unit),
            ratio(Tag::FocalPlaneXResolution, 8_000, 1),
            (Tag::PixelXDimension, Value::Long(vec![taken / 2])),
            (Tag::PixelYDimension, Value::Long(vec![taken])),
        ])
    };
    assert_eq!(with(3, 4000), Some(4000.0));
    assert_eq!(with(3, 8000), Some(2000.0), "reduced to half after it was taken");
    assert_eq!(with(4, 4000), Some(40_000.0));
    assert_eq!(with(9, 4000), None, "a unit nobody knows");
}

#[test]
fn the_device_is_make_and_model_trimmed() {
    let device = |fields: &[(Tag, Value)]| read(&jpeg(fields), 100).device;
    let both = [text(Tag::Make, b" HUAWEI "), text(Tag::Model, b"P20\tlite\n")];
    assert_eq!(device(&both).as_deref(), Some("HUAWEI P20 lite"));
    assert_eq!(device(&both[..1]).as_deref(), Some("HUAWEI"));
    assert_eq!(device(&[text(Tag::Make, b"  ")]), None);
    assert_eq!(
        device(&[text(Tag::Model, &[b'x'; 900])]).unwrap().len(),
        MAX_DEVICE
    );
}

#[test]
fn no_exif_says_nothing_and_absurd_numbers_are_noted() {
    assert_eq!(read(&[0xff, 0xd8, 0xff, 0xd9], 100), Lens::default());
    assert_eq!(read(b"GIF89a", 100), Lens::default());
    let absurd = read(&jpeg(&[short(Tag::FocalLengthIn35mmFilm, 65535)]), 4000);
    assert_eq!(absurd.focal_px, None);
    assert_eq!(
        absurd.notes,
        ["EXIF's focal length of 7281667 px is not believed: the photo has 4000 px"]
    );
    let resolution = ratio(Tag::FocalPlaneXResolution, 8_000, 1);
    for (num, denom) in [(0, 1), (1, 0), (0, 0)] {
        assert_eq!(
            focal(&[ratio(Tag::FocalLength, num, denom), resolution.clone()]),
            None,
            "{num}/{denom}"
        );
    }
}

#[test]
fn exif_that_is_cut_or_damaged_anywhere_costs_no_photo() {
    let whole = jpeg(&[
        text(Tag::Make, b"NASA, the Mars helicopter"),
        short(Tag::FocalLengthIn35mmFilm, 27),
        ratio(Tag::FocalLength, 5, 1),
        ratio(Tag::FocalPlaneXResolution, 10_000, 1),
    ]);
    let sound = |lens: Lens, what: &str| {
        assert!(
            lens.focal_px
                .is_none_or(|focal_px| (400.0..=200_000.0).contains(&focal_px)),
            "{what}: {lens:?}"
        );
    };
    for at in 0..whole.len() {
        sound(read(&whole[..at], 4000), &format!("cut at {at}"));
        for bit in 0..8 {
            let mut bytes = whole.clone();
            bytes[at] ^= 1 << bit;
            sound(read(&bytes, 4000), &format!("bit {bit} of byte {at}"));
        }
    }
    // With a count of 255 fields, the existing ones are read and a note reports the damage.
    let mut bytes = whole.clone();
    let count = bytes
        .windows(4)
        .position(|part| part == [0x00, 0x2a, 0, 0])
        .unwrap()
        + 6;
    bytes[count + 1] = 255;
    let lens = read(&bytes, 4000);
    assert!(
        lens.notes.iter().any(|note| note.starts_with("EXIF is damaged")),
        "{lens:?}"
    );
}

/// As Pillow and several phones write it: the chunk has the prefix of a JPEG.
#[test]
fn exif_of_a_webp_is_read_with_and_without_a_prefix() {
    let whole = jpeg(&[short(Tag::FocalLengthIn35mmFilm, 27)]);
    // Behind the markers, the length and the prefix.
    let tiff = &whole[12..whole.len() - 2];
    for prefix in [&b"Exif\0\0"[..], b""] {
        let body = [prefix, tiff].concat();
        let size = (body.len() as u32).to_le_bytes();
        let mut chunks = [b"WEBPVP8L\x01\0\0\0\x2f\0EXIF".as_slice(), &size, &body].concat();
        chunks.resize(chunks.len().next_multiple_of(2), 0);
        let webp = [b"RIFF".as_slice(), &(chunks.len() as u32).to_le_bytes(), &chunks].concat();
        let lens = read(&webp, 4000);
        assert_eq!(lens.focal_px, Some(3000.0), "{prefix:?}: {:?}", lens.notes);
    }
}
