use std::io::Cursor;

use tiff::encoder::colortype::{ColorType, Gray16, Gray32, GrayI16, RGB8, RGB16, RGB32, RGB32Float, RGBA8};
use tiff::encoder::{DirectoryEncoder, TiffEncoder, TiffKindStandard, TiffValue};

use super::*;
use crate::photo::tests::tiff_of;

type Tags<'a> = DirectoryEncoder<'a, &'a mut Cursor<Vec<u8>>, TiffKindStandard>;

/// A TIFF of one line with further tags.
fn tiff<C: ColorType>(samples: &[C::Inner], width: u32, tag: impl FnOnce(&mut Tags<'_>)) -> Vec<u8>
where
    [C::Inner]: TiffValue,
{
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).unwrap();
    let mut image = encoder.new_image::<C>(width, 1).unwrap();
    tag(image.encoder());
    image.write_data(samples).unwrap();
    bytes.into_inner()
}

/// The pixels of a TIFF, and its notes in one line.
fn pixels(bytes: &[u8]) -> (Vec<[u8; 3]>, String) {
    let photo = Photo::decode(bytes).unwrap();
    (photo.image.pixels, photo.notes.join("; "))
}

/// As libtiff and Pillow read it: premultiplied (100, 99, 92) at opacity 128 is (199, 197, 183) straight.
#[test]
fn premultiplied_alpha_is_not_blended_again() {
    let with = |extra: u16| {
        let samples = [100, 99, 92, 128, 200, 10, 0, 255, 0, 0, 0, 0];
        tiff::<RGBA8>(&samples, 3, |tags| {
            tags.write_tag(Tag::ExtraSamples, extra).unwrap()
        })
    };
    let photo = Photo::decode(&with(1)).unwrap();
    assert_eq!(photo.image.pixels, [[100, 99, 92], [200, 10, 0], [0; 3]]);
    assert_eq!(photo.alpha, [128, 255, 0]);
    assert_eq!(photo.notes, ["alpha is blended over black in the file"]);
    let png = image::load_from_memory(&photo.to_png().unwrap())
        .unwrap()
        .to_rgba8();
    assert_eq!(png.get_pixel(0, 0).0, [199, 197, 183, 128]);
    let straight = Photo::decode(&with(2)).unwrap();
    assert_eq!(straight.image.pixels[0], [50, 50, 46]);
}

/// A fourth sample that is not an opacity by its tag hides nothing.
#[test]
fn an_extra_sample_that_is_no_opacity_is_left_out() {
    let bytes = tiff::<RGBA8>(&[10, 20, 30, 0], 1, |tags| {
        tags.write_tag(Tag::ExtraSamples, 0_u16).unwrap()
    });
    let photo = Photo::decode(&bytes).unwrap();
    assert_eq!(
        (photo.image.pixels, photo.alpha),
        (vec![[10, 20, 30]], Vec::new())
    );
}

/// By hand: 2048 of 4095 is 127.5 of 255, which rounds to 128, and 2048 of 65535 is 8.
#[test]
fn twelve_bits_in_sixteen_are_scaled_by_their_tag_and_reported_without_one() {
    let samples = [0_u16, 2048, 4095];
    for tag in [Tag::MaxSampleValue, Tag::SMaxSampleValue, Tag::Unknown(50_717)] {
        let bytes = tiff::<RGB16>(&samples, 1, |tags| tags.write_tag(tag, 4095_u16).unwrap());
        let (found, notes) = pixels(&bytes);
        assert_eq!(found, [[0, 128, 255]], "{tag:?}");
        assert!(notes.contains("white is 4095 by its tag"), "{notes}");
        assert!(
            notes.contains("16-bit integers from 0 to 4095 reduced to 8 bits"),
            "{notes}"
        );
    }
    let (found, notes) = pixels(&tiff::<RGB16>(&samples, 1, |_| ()));
    assert_eq!(found, [[0, 8, 16]]);
    assert!(
        notes.contains("doubtful tones: the largest sample is 4095"),
        "{notes}"
    );
    // The largest sample that occurs is not a range.
    let bytes = tiff::<RGB16>(&[0, 2048, 40_000], 1, |tags| {
        tags.write_tag(Tag::MaxSampleValue, 40_000_u16).unwrap();
    });
    assert_eq!(
        pixels(&bytes),
        (vec![[0, 8, 156]], "16 bits reduced to 8".to_owned())
    );
}

#[test]
fn integers_of_32_bits_have_their_range_by_tag_or_by_the_largest_sample() {
    let (found, notes) = pixels(&tiff::<RGB32>(&[0, 1 << 31, u32::MAX], 1, |_| ()));
    assert_eq!(found, [[0, 128, 255]]);
    assert!(!notes.contains("doubtful"), "{notes}");
    let (found, notes) = pixels(&tiff::<RGB32>(&[0, 32_768, 65_535], 1, |_| ()));
    assert_eq!(found, [[0, 128, 255]]);
    assert!(
        notes.contains("doubtful")
            && notes.contains("65535 is taken")
            && notes.contains(" from 0 to 65535 reduced to 8 bits"),
        "{notes}"
    );
    let bytes = tiff::<RGB32>(&[0, 100, 200], 1, |tags| {
        tags.write_tag(Tag::SMaxSampleValue, 65_535_u32).unwrap()
    });
    assert_eq!(pixels(&bytes).0, [[0, 0, 1]]);
    assert_eq!(
        pixels(&tiff::<Gray32>(&[u32::MAX, 1 << 30], 2, |_| ())).0,
        [[255; 3], [64; 3]]
    );
    assert_eq!(
        pixels(&tiff::<GrayI16>(&[-5, 16_384], 2, |_| ())).0,
        [[0; 3], [128; 3]]
    );
}

#[test]
fn floats_are_taken_from_0_to_1_or_to_255() {
    let (found, notes) = pixels(&tiff::<RGB32Float>(&[-1.0, 0.5, 1.0], 1, |_| ()));
    assert_eq!(found, [[0, 128, 255]]);
    assert!(!notes.contains("doubtful"), "{notes}");
    let (found, notes) = pixels(&tiff::<RGB32Float>(
        &[0.0, 128.0, 255.0, 3.0, f32::NAN, 77.4],
        2,
        |_| (),
    ));
    assert_eq!(found, [[0, 128, 255], [3, 0, 77]]);
    assert!(
        notes.contains("doubtful") && notes.contains("255 is taken"),
        "{notes}"
    );
    let tagged = tiff::<RGB32Float>(&[0.0, 0.5, 0.9], 1, |tags| {
        tags.write_tag(Tag::SMaxSampleValue, 255.0_f32).unwrap();
    });
    let (found, notes) = pixels(&tagged);
    assert_eq!(found, [[0, 1, 1]]);
    assert!(!notes.contains("doubtful"), "{notes}");
    // One highlight above 1.
    let (found, notes) = pixels(&tiff::<RGB32Float>(&[0.25, 0.5, 1.5], 1, |_| ()));
    assert_eq!(found, [[64, 128, 255]]);
    assert!(notes.contains("doubtful"), "{notes}");
}

#[test]
fn a_dark_photo_of_16_bits_is_read_as_before() {
    let (found, _) = pixels(&tiff::<Gray16>(&[0, 257, 65_535], 3, |_| ()));
    assert_eq!(found, [[0; 3], [1; 3], [255; 3]]);
}

#[test]
fn a_big_tiff_is_read() {
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new_big(&mut bytes).unwrap();
    encoder.write_image::<RGB8>(2, 1, &[1, 2, 3, 4, 5, 6]).unwrap();
    let bytes = bytes.into_inner();
    assert!(bytes.starts_with(BIG[0]) || bytes.starts_with(BIG[1]));
    assert_eq!(pixels(&bytes).0, [[1, 2, 3], [4, 5, 6]]);
    assert_eq!(
        (Photo::format(&bytes), Photo::size_px(&bytes)),
        (Some("TIFF"), Some((2, 1)))
    );
}

/// A strip that is a whole JPEG of Y, Cb and Cr, as GDAL and libtiff write it.
#[test]
fn a_jpeg_in_a_tiff_has_the_colours_of_the_jpeg() {
    let image = crate::Image::from_fn(32, 16, |x, y| [(x * 7) as u8, (y * 15) as u8, 90]);
    let jpeg = crate::encode_jpeg(&image, 95).unwrap();
    let bytes = tiff_of(
        &[
            (256, &[32]),
            (257, &[16]),
            (258, &[8, 8, 8]),
            (259, &[7]),
            (262, &[6]),
            (277, &[3]),
            (278, &[16]),
            (530, &[1, 1]),
        ],
        [273, 279],
        std::slice::from_ref(&jpeg),
    );
    let expected = Photo::decode(&jpeg).unwrap().image.pixels;
    let found = pixels(&bytes).0;
    let off = found.as_flattened().iter().zip(expected.as_flattened());
    let most = off.map(|(a, b)| a.abs_diff(*b)).max().unwrap();
    assert!(most <= 1, "{most}"); // two ways of rounding
}

#[test]
fn a_compression_that_is_not_read_is_named() {
    let bytes = tiff_of(
        &[
            (256, &[4]),
            (257, &[4]),
            (258, &[8]),
            (259, &[50_000]),
            (262, &[1]),
            (277, &[1]),
            (278, &[4]),
        ],
        [273, 279],
        &[vec![0; 16]],
    );
    let error = Photo::decode(&bytes).unwrap_err().to_string();
    let way_out = "save it as gray or RGB of 8 or 16 bits, uncompressed or with LZW, Deflate or JPEG";
    assert!(error.contains("ZSTD") && error.contains(way_out), "{error}");
}
