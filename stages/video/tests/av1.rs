//! AV1: files are read back by a reader of boxes and units of their own, and decoded by ffmpeg where it is installed.
#![cfg(feature = "av1")]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a test that cannot go on should stop; a skipped one says so"
)]

mod common;

use common::*;
use marf_scene::{Image, Srgb};
use marf_video::Codec;

const SEQUENCE_HEADER: u8 = 1;
const FRAME: u8 = 6;

/// Returns the units of a sample: type and bytes.
fn units(sample: &[u8]) -> Vec<(u8, &[u8])> {
    let (mut found, mut rest) = (Vec::new(), sample);
    while !rest.is_empty() {
        assert_eq!(rest[0] & 0x87, 2, "a header with a length and without extension");
        let digits = 1 + rest[1..].iter().take_while(|byte| **byte >= 0x80).count();
        let length = (0..digits).map(|digit| usize::from(rest[1 + digit] & 0x7f) << (7 * digit));
        let (unit, behind) = rest.split_at(1 + digits + length.sum::<usize>());
        found.push((unit[0] >> 3, unit));
        rest = behind;
    }
    found
}

fn parsed(pictures: &[Image<Srgb>], rate: u32, quantizer: u32) -> Parsed {
    parse(
        &encode(pictures, settings(Codec::Av1, rate, quantizer)).unwrap(),
        Codec::Av1,
    )
}

/// "AV1 Codec ISO Media File Format Binding", sections 2.3 and 2.4.
#[test]
fn samples_are_frames_and_key_ones_begin_with_the_sequence_header_of_the_record() {
    let parsed = parsed(&pictures(208, 120, 60), 24, 26);
    assert_eq!((parsed.width, parsed.height), (208, 120));
    assert_eq!((parsed.timescale, parsed.delta), (24_000, 1000));
    assert_eq!((parsed.samples.len(), parsed.keys.as_slice()), (60, &[1, 49][..]));
    // Version 1. Main profile, no limit of level. 4:2:0 of 8 bits, chroma position unspecified. No delay
    // stated.
    assert_eq!(parsed.config[..4], [0x81, 31, 0x0c, 0]);
    for (sample, number) in parsed.samples.iter().zip(1..) {
        let (units, is_key) = (units(sample), parsed.keys.contains(&number));
        let kinds: Vec<u8> = units.iter().map(|(kind, _)| *kind).collect();
        let expected: &[u8] = if is_key {
            &[SEQUENCE_HEADER, FRAME]
        } else {
            &[FRAME]
        };
        assert_eq!(kinds, expected, "picture {number}");
        if is_key {
            assert_eq!(units[0].1, &parsed.config[4..], "picture {number}");
        }
    }
}

/// ffmpeg (dav1d or libaom) decodes the encoded pictures, colours included. Measured: 37.6, 37.0 and 33.4 dB.
#[test]
fn ffmpeg_decodes_a_moving_pattern_the_better_the_finer_the_quantiser() {
    let pictures = pictures(208, 120, 50);
    let decoded = |quantizer| {
        let file = encode(&pictures, settings(Codec::Av1, 24, quantizer)).unwrap();
        let found = ffmpeg_decodes(&file, 208, 120).map(|decoded| {
            assert_eq!(decoded.len(), 50);
            psnr(&decoded, &pictures)
        });
        println!("quantiser {quantizer}: {} bytes, {found:.2?} dB", file.len());
        (file.len(), found)
    };
    let (fine, usual, coarse) = (decoded(12), decoded(20), decoded(36));
    assert!(
        fine.0 > usual.0 && usual.0 > coarse.0,
        "{fine:?} {usual:?} {coarse:?}"
    );
    if let (Some(fine), Some(usual), Some(coarse)) = (fine.1, usual.1, coarse.1) {
        assert!(usual > 34.5, "{usual} dB");
        assert!(fine > usual && usual > coarse, "{fine} {usual} {coarse} dB");
    }
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
        let file = encode(&pictures, settings(Codec::Av1, 24, 12)).unwrap();
        let parsed = parse(&file, Codec::Av1);
        let side = |side: u32| side.next_multiple_of(2).max(16);
        let even = (side(width), side(height));
        assert_eq!((parsed.width, parsed.height), even, "{width} x {height}");
        assert_eq!(parsed.samples.len(), count as usize, "{width} x {height}");
        let Some(decoded) = ffmpeg_decodes(&file, even.0, even.1) else {
            continue;
        };
        assert_eq!(decoded.len(), count as usize, "{width} x {height}");
        let found = psnr(&decoded, &pictures);
        // Neighbours differ by up to 80 levels here, and share their chroma.
        assert!(found > 20.0, "{width} x {height}: {found} dB");
    }
}

#[test]
fn the_largest_and_the_narrowest_pictures_are_encoded() {
    for (width, height) in [(3840, 2160), (1, 3840), (3840, 1)] {
        let picture = Image::from_fn(width, height, |column, row| {
            [(column / 20) as u8, (row / 20) as u8, 90]
        });
        let file = encode(std::slice::from_ref(&picture), settings(Codec::Av1, 240, 40)).unwrap();
        let parsed = parse(&file, Codec::Av1);
        assert_eq!(
            (parsed.width, parsed.height),
            (width.max(16), height.max(16)),
            "{width} x {height}"
        );
        if let Some(decoded) = ffmpeg_decodes(&file, parsed.width, parsed.height) {
            let found = psnr(&decoded, &[picture]);
            assert!(found > 30.0, "{width} x {height}: {found} dB");
        }
    }
}

#[test]
fn rates_from_1_to_240_are_in_the_file_and_change_no_picture() {
    let pictures = pictures(64, 48, 6);
    let first = parsed(&pictures, 1, 28);
    for rate in [24, 240] {
        let other = parsed(&pictures, rate, 28);
        assert_eq!((other.timescale, other.delta), (rate * 1000, 1000));
        assert!(other.samples == first.samples, "at {rate} a second");
    }
}

#[test]
fn noise_is_whole() {
    noise_is_encoded_whole(Codec::Av1);
}

/// If this digest changes, videos change. Then raise the version of the stage that makes them, unless only
/// this machine's `exp` differs in its last bit (see the head of the crate).
#[test]
fn the_same_pictures_give_the_same_bytes_in_any_thread() {
    assert_eq!(digest_of_any_thread(Codec::Av1), "fba8c8359009");
}

/// A reader that is not ours, where there is one.
#[test]
fn ffprobe_reads_size_rate_and_colors() {
    let file = encode(&pictures(98, 64, 30), settings(Codec::Av1, 25, 24)).unwrap();
    ffprobe_finds(
        &file,
        &[
            "codec_name=av1",
            "width=98",
            "height=64",
            "pix_fmt=yuv420p",
            "r_frame_rate=25/1",
            "nb_frames=30",
            "color_range=tv",
            "color_space=bt709",
        ],
    );
}
