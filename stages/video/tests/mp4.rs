//! Files are read back by a reader of boxes of their own and decoded by OpenH264's decoder.
#![cfg(feature = "h264")]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stderr,
    reason = "a test that cannot go on should stop; a skipped one says so"
)]

use std::collections::BTreeMap;

use marf_cache::Digest;
use marf_scene::{Image, Srgb};
use marf_video::{Encoder, Settings, VideoError};
use openh264::{decoder::Decoder, formats::YUVSource};

fn settings(frames_per_second: u32, quantizer: u32) -> Settings {
    Settings {
        frames_per_second,
        quantizer,
    }
}

/// A slope of colours with a bright square that moves over it.
fn picture(width: u32, height: u32, index: u32) -> Image<Srgb> {
    Image::from_fn(width, height, |column, row| {
        let square = (column + 200 - index * 3) % 97 < 16 && row % 61 < 16;
        let slope = |along: u32, of: u32| (40 + along * 160 / of.max(1)) as u8;
        match square {
            true => [230, 200, 90],
            false => [
                slope(column, width),
                slope(row, height),
                slope(column + row, width + height),
            ],
        }
    })
}

fn pictures(width: u32, height: u32, count: u32) -> Vec<Image<Srgb>> {
    (0..count).map(|index| picture(width, height, index)).collect()
}

fn encode(pictures: &[Image<Srgb>], settings: Settings) -> Result<Vec<u8>, VideoError> {
    let mut encoder = Encoder::new(settings)?;
    pictures.iter().try_for_each(|picture| encoder.push(picture))?;
    encoder.finish()
}

/// Boxes that hold boxes, each with the bytes before its first child.
const PARENTS: [(&str, usize); 8] = [
    ("moov", 0),
    ("trak", 0),
    ("mdia", 0),
    ("minf", 0),
    ("dinf", 0),
    ("stbl", 0),
    ("stsd", 8),
    ("avc1", 78),
];

/// Returns every box by its path, with its content.
fn boxes<'a>(bytes: &'a [u8], path: &str, found: &mut BTreeMap<String, &'a [u8]>) {
    let mut rest = bytes;
    while !rest.is_empty() {
        let length = u32::from_be_bytes(rest[..4].try_into().unwrap()) as usize;
        let kind = std::str::from_utf8(&rest[4..8]).unwrap();
        assert!(
            (8..=rest.len()).contains(&length),
            "{path}/{kind}: {length} of {}",
            rest.len()
        );
        let (content, name) = (&rest[8..length], format!("{path}/{kind}"));
        if let Some((_, before)) = PARENTS.iter().find(|(parent, _)| *parent == kind) {
            boxes(&content[*before..], &name, found);
        }
        assert!(found.insert(name, content).is_none(), "{path}/{kind} twice");
        rest = &rest[length..];
    }
}

/// What a file says of itself.
struct Parsed {
    width: u32,
    height: u32,
    timescale: u32,
    /// Units of time of a picture.
    delta: u32,
    keys: Vec<u32>,
    sets: Vec<Vec<u8>>,
    samples: Vec<Vec<u8>>,
}

fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap())
}

fn half(bytes: &[u8], at: usize) -> usize {
    usize::from(u16::from_be_bytes(bytes[at..at + 2].try_into().unwrap()))
}

fn parse(file: &[u8]) -> Parsed {
    let mut found = BTreeMap::new();
    boxes(file, "", &mut found);
    let track = |name: &str| found[&format!("/moov/trak/{name}")];
    let table = |name: &str| track(&format!("mdia/minf/stbl/{name}"));
    assert_eq!(&found["/ftyp"][..4], b"isom");
    assert_eq!(
        table("stsd/avc1/colr"),
        b"nclx\0\x01\0\x01\0\x01\0",
        "BT.709, limited range"
    );
    assert_eq!(&track("mdia/hdlr")[8..12], b"vide");
    let (avcc, sizes, times) = (table("stsd/avc1/avcC"), table("stsz"), table("stts"));
    let count = word(sizes, 8) as usize;
    assert_eq!((word(times, 4), word(times, 8) as usize), (1, count));
    assert_eq!(avcc[4..6], [0xff, 0xe1]);
    let sps = &avcc[8..8 + half(avcc, 6)];
    let rest = &avcc[8 + sps.len()..];
    let pps = &rest[3..3 + half(rest, 1)];
    assert_eq!(avcc[1..4], sps[1..4], "profile and level");
    let mut at = word(table("stco"), 8) as usize;
    let samples = (0..count).map(|index| {
        let size = word(sizes, 12 + 4 * index) as usize;
        at += size;
        file[at - size..at].to_vec()
    });
    let samples: Vec<Vec<u8>> = samples.collect();
    assert_eq!(at, file.len(), "the samples are the end of the file");
    let (keys, media) = (table("stss"), track("mdia/mdhd"));
    let delta = word(times, 12);
    assert_eq!(word(media, 16), delta * count as u32, "length of the track");
    Parsed {
        width: word(track("tkhd"), 76) >> 16,
        height: word(track("tkhd"), 80) >> 16,
        timescale: word(media, 12),
        delta,
        keys: (0..word(keys, 4) as usize)
            .map(|index| word(keys, 8 + 4 * index))
            .collect(),
        sets: vec![sps.to_vec(), pps.to_vec()],
        samples,
    }
}

/// Returns the pictures of a file, in RGB.
fn decode(parsed: &Parsed) -> Vec<Image<Srgb>> {
    let mut decoder = Decoder::new().unwrap();
    let mut stream: Vec<u8> = parsed
        .sets
        .iter()
        .flat_map(|set| [&[0, 0, 0, 1], set.as_slice()].concat())
        .collect();
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

fn psnr(a: &[Image<Srgb>], b: &[Image<Srgb>]) -> f64 {
    let (mut squares, mut count) = (0.0, 0.0);
    for (a, b) in a.iter().zip(b) {
        for row in 0..b.height {
            for column in 0..b.width {
                for (a, b) in a.at(column, row).iter().zip(b.at(column, row)) {
                    squares += (f64::from(*a) - f64::from(b)).powi(2);
                    count += 1.0;
                }
            }
        }
    }
    10.0 * (255.0_f64.powi(2) * count / squares).log10()
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

/// Noise takes many bits: an encoder that held a rate would drop pictures or spoil them.
#[test]
fn noise_is_encoded_whole() {
    let noise = |index: u32| {
        Image::from_fn(96, 64, |column, row| {
            let place = column + 96 * (row + 64 * index);
            let mixed = place
                .wrapping_mul(2_654_435_761)
                .rotate_left(13)
                .wrapping_mul(2_246_822_519);
            [(mixed >> 8) as u8, (mixed >> 12) as u8, (mixed >> 16) as u8]
        })
    };
    let pictures: Vec<Image<Srgb>> = (0..20).map(noise).collect();
    let parsed = parse(&encode(&pictures, settings(24, 24)).unwrap());
    assert_eq!(parsed.samples.len(), 20);
    let least = parsed.samples.iter().map(Vec::len).min().unwrap();
    assert!(least > 96 * 64 / 4, "{least} bytes for a picture of noise");
}

/// If this digest changes, videos change: raise the version of the stage that makes them.
#[test]
fn the_same_pictures_give_the_same_bytes_in_any_thread() {
    let file = || Digest::of(&encode(&pictures(100, 60, 50), settings(24, 24)).unwrap());
    let threads: Vec<_> = (0..3).map(|_| std::thread::spawn(file)).collect();
    let found: Vec<Digest> = threads.into_iter().map(|thread| thread.join().unwrap()).collect();
    assert!(found.iter().all(|digest| *digest == file()), "{found:?}");
    assert_eq!(found[0].short(), "6c692f703d89");
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
    let folder = std::env::temp_dir().join(format!("marf-video-{}.mp4", std::process::id()));
    std::fs::write(&folder, encode(&pictures(98, 64, 30), settings(25, 24)).unwrap()).unwrap();
    let asked = "stream=codec_name,width,height,r_frame_rate,nb_frames,color_range,color_space";
    let probe = std::process::Command::new("ffprobe")
        .args([
            "-v",
            "error",
            "-show_entries",
            asked,
            "-of",
            "default=noprint_wrappers=1",
        ])
        .arg(&folder)
        .output();
    std::fs::remove_file(&folder).unwrap();
    let Ok(probe) = probe else {
        eprintln!("skipped ffprobe_reads_size_rate_and_colors: no ffprobe");
        return;
    };
    let text = String::from_utf8_lossy(&probe.stdout);
    for line in [
        "codec_name=h264",
        "width=98",
        "height=64",
        "r_frame_rate=25/1",
        "nb_frames=30",
        "color_range=tv",
        "color_space=bt709",
    ] {
        assert!(
            text.lines().any(|found| found == line),
            "{line} is not in\n{text}"
        );
    }
    assert!(
        probe.stderr.is_empty(),
        "{}",
        String::from_utf8_lossy(&probe.stderr)
    );
}
