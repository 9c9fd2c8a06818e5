//! H.264: files are read back by a reader of boxes of their own and decoded by OpenH264's decoder.
#![cfg(feature = "h264")]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a test that cannot go on should stop; a skipped one says so"
)]

mod common;

use common::*;
use marf_scene::{Image, Srgb};
use openh264::{decoder::Decoder, formats::YUVSource};

/// Returns the pictures of a file, in RGB.
fn decode(parsed: &Parsed) -> Vec<Image<Srgb>> {
    let mut decoder = Decoder::new().unwrap();
    let avcc = &parsed.config;
    assert_eq!(avcc[4..6], [0xff, 0xe1]);
    let sps = &avcc[8..8 + half(avcc, 6)];
    let rest = &avcc[8 + sps.len()..];
    let pps = &rest[3..3 + half(rest, 1)];
    assert_eq!(avcc[1..4], sps[1..4], "profile and level");
    let mut stream = [&[0, 0, 0, 1], sps, &[0, 0, 0, 1], pps].concat();
    let mut pictures = Vec::new();
    for sample in &parsed.samples {
        let mut rest = sample.as_slice();
        while !rest.is_empty() {
            let length = word(rest, 0) as usize;
            stream.extend([0, 0, 0, 1]);
            stream.extend(&rest[4..4 + length]);
            rest = &rest[4 + length..];
        }
        let decoded = decoder
            .decode(&stream)
            .unwrap()
            .expect("a picture for every sample");
        assert_eq!(
            decoded.dimensions(),
            (parsed.width as usize, parsed.height as usize)
        );
        pictures.push(rgb(&decoded));
        stream.clear();
    }
    pictures
}

/// BT.709 of limited range in floats, the nearest chroma sample.
fn rgb(yuv: &impl YUVSource) -> Image<Srgb> {
    let ((width, height), (y, u, v)) = (yuv.dimensions(), yuv.strides());
    Image::from_fn(width as u32, height as u32, |column, row| {
        let (column, row) = (column as usize, row as usize);
        let luma = (f64::from(yuv.y()[row * y + column]) - 16.0) / 219.0;
        let blue = (f64::from(yuv.u()[row / 2 * u + column / 2]) - 128.0) / 224.0 * 1.8556;
        let red = (f64::from(yuv.v()[row / 2 * v + column / 2]) - 128.0) / 224.0 * 1.5748;
        let green = -(0.2126 * red + 0.0722 * blue) / 0.7152;
        [red, green, blue].map(|off| ((luma + off) * 255.0).round().clamp(0.0, 255.0) as u8)
    })
}

/// Measured: 36.3, 36.0 and 32.5 dB. Most of the loss is at the edges of the square, whose chroma is a quarter as dense.
#[test]
fn a_moving_pattern_comes_back_and_is_the_better_the_finer_the_quantiser() {
    let pictures = pictures(208, 120, 60);
    let decoded = |quantizer| {
        let file = encode(&pictures, settings(24, quantizer)).unwrap();
        let parsed = parse(&file);
        assert_eq!((parsed.width, parsed.height), (208, 120));
        assert_eq!((parsed.timescale, parsed.delta), (24_000, 1000));
        assert_eq!((parsed.samples.len(), parsed.keys.as_slice()), (60, &[1, 49][..]));
        let found = psnr(&decode(&parsed), &pictures);
        eprintln!("quantiser {quantizer}: {} bytes, {found:.2} dB", file.len());
        (file.len(), found)
    };
    let (fine, usual, coarse) = (decoded(12), decoded(20), decoded(36));
    assert!(usual.1 > 35.5, "{} dB", usual.1);
    assert!(
        fine.1 > usual.1 && usual.1 > coarse.1,
        "{fine:?} {usual:?} {coarse:?}"
    );
    assert!(
        fine.0 > usual.0 && usual.0 > coarse.0,
        "{fine:?} {usual:?} {coarse:?}"
    );
}

#[test]
fn one_picture_small_ones_and_odd_ones_come_back_in_even_sizes() {
    for (width, height, count) in [
        (2, 2, 3),
        (1, 1, 1),
        (3, 5, 2),
        (16, 16, 1),
        (63, 35, 4),
        (33, 2, 2),
    ] {
        let pictures = pictures(width, height, count);
        let parsed = parse(&encode(&pictures, settings(24, 12)).unwrap());
        let side = |side: u32| side.next_multiple_of(2).max(16);
        let even = (side(width), side(height));
        assert_eq!((parsed.width, parsed.height), even, "{width} x {height}");
        let decoded = decode(&parsed);
        assert_eq!(decoded.len(), count as usize, "{width} x {height}");
        let found = psnr(&decoded, &pictures);
        // Neighbours differ by up to 80 levels here, and share their chroma.
        assert!(found > 20.0, "{width} x {height}: {found} dB");
        if width % 2 == 1 {
            let last = |column| decoded[0].at(column, 0)[1];
            let step = last(width).abs_diff(last(width - 1));
            assert!(
                step <= 12,
                "{width} x {height}: the last column is repeated, off by {step}"
            );
        }
    }
}

#[test]
fn rates_from_1_to_240_are_in_the_file_and_drop_no_picture() {
    let pictures = pictures(64, 48, 12);
    let mut samples = Vec::new();
    for rate in [1, 10, 24, 25, 60, 120, 240] {
        let parsed = parse(&encode(&pictures, settings(rate, 28)).unwrap());
        assert_eq!((parsed.timescale, parsed.delta), (rate * 1000, 1000));
        assert_eq!(parsed.samples.len(), 12, "at {rate} a second");
        samples.push(parsed.samples);
    }
    assert!(
        samples.iter().all(|found| *found == samples[0]),
        "a rate changes times, not pictures"
    );
}

#[test]
fn noise_is_whole() {
    noise_is_encoded_whole();
}

/// If this digest changes, videos change: raise the version of the stage that makes them.
#[test]
fn the_same_pictures_give_the_same_bytes_in_any_thread() {
    assert_eq!(digest_of_any_thread(), "6c692f703d89");
}

#[test]
fn what_cannot_be_encoded_is_refused_with_its_number() {
    let refused = |pictures: &[Image<Srgb>], settings| encode(pictures, settings).unwrap_err().to_string();
    assert_eq!(
        refused(&[], settings(24, 24)),
        "a video needs at least one picture"
    );
    let two = [picture(8, 8, 0), picture(8, 6, 1)];
    assert_eq!(
        refused(&two, settings(24, 24)),
        "picture 2 has 8 x 6 pixels, the first one 8 x 8"
    );
    let wide = [picture(3842, 1, 0)];
    assert!(refused(&wide, settings(24, 24)).starts_with("pictures have 3842 x 1 pixels"));
    assert!(refused(&[picture(0, 3, 0)], settings(24, 24)).contains("shows nothing"));
    assert!(refused(&two, settings(0, 24)).starts_with("0 pictures a second"));
    assert!(refused(&two, settings(24, 52)).starts_with("quantiser 52"));
}

/// A reader that is not ours, where there is one.
#[test]
fn ffprobe_reads_size_rate_and_colors() {
    let file = encode(&pictures(98, 64, 30), settings(25, 24)).unwrap();
    ffprobe_finds(
        &file,
        &[
            "codec_name=h264",
            "width=98",
            "height=64",
            "r_frame_rate=25/1",
            "nb_frames=30",
            "color_range=tv",
            "color_space=bt709",
        ],
    );
}
