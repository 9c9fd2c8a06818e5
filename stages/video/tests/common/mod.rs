//! Parts of the tests: pictures, an own reader of boxes, and independent readers.
#![allow(dead_code, reason = "no test uses all of it")]

use std::collections::BTreeMap;
use std::process::{Command, Output};

use marf_cache::Digest;
use marf_scene::{Image, Srgb};
use marf_video::{Encoder, Settings, VideoError};

pub fn settings(frames_per_second: u32, quantizer: u32) -> Settings {
    Settings {
        frames_per_second,
        quantizer,
    }
}

/// A slope of colours with a bright square that moves over it.
pub fn picture(width: u32, height: u32, index: u32) -> Image<Srgb> {
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

pub fn pictures(width: u32, height: u32, count: u32) -> Vec<Image<Srgb>> {
    (0..count).map(|index| picture(width, height, index)).collect()
}

pub fn encode(pictures: &[Image<Srgb>], settings: Settings) -> Result<Vec<u8>, VideoError> {
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
pub fn boxes<'a>(bytes: &'a [u8], path: &str, found: &mut BTreeMap<String, &'a [u8]>) {
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

/// Contents of a file by its boxes.
pub struct Parsed {
    pub width: u32,
    pub height: u32,
    pub timescale: u32,
    /// Units of time of a picture.
    pub delta: u32,
    /// Pictures from which decoding can begin, from 1.
    pub keys: Vec<u32>,
    /// Content of `avcC`.
    pub config: Vec<u8>,
    pub samples: Vec<Vec<u8>>,
}

pub fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap())
}

pub fn half(bytes: &[u8], at: usize) -> usize {
    usize::from(u16::from_be_bytes(bytes[at..at + 2].try_into().unwrap()))
}

/// Reads a file.
pub fn parse(file: &[u8]) -> Parsed {
    let (entry, config) = ("avc1", "avcC");
    let mut found = BTreeMap::new();
    boxes(file, "", &mut found);
    let track = |name: &str| found[&format!("/moov/trak/{name}")];
    let table = |name: &str| track(&format!("mdia/minf/stbl/{name}"));
    assert_eq!(&found["/ftyp"][..4], b"isom");
    assert!(
        found["/ftyp"][8..]
            .chunks(4)
            .any(|brand| brand == entry.as_bytes())
    );
    assert_eq!(
        table(&format!("stsd/{entry}/colr")),
        b"nclx\0\x01\0\x01\0\x01\0",
        "BT.709, limited range"
    );
    assert_eq!(&track("mdia/hdlr")[8..12], b"vide");
    let (config, sizes) = (table(&format!("stsd/{entry}/{config}")), table("stsz"));
    let times = table("stts");
    let count = word(sizes, 8) as usize;
    assert_eq!((word(times, 4), word(times, 8) as usize), (1, count));
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
        config: config.to_vec(),
        samples,
    }
}

pub fn psnr(a: &[Image<Srgb>], b: &[Image<Srgb>]) -> f64 {
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

/// A picture without structure, another one for every index.
pub fn noise(width: u32, height: u32, index: u32) -> Image<Srgb> {
    Image::from_fn(width, height, |column, row| {
        let place = column + width * (row + height * index);
        let mixed = place
            .wrapping_mul(2_654_435_761)
            .rotate_left(13)
            .wrapping_mul(2_246_822_519);
        [(mixed >> 8) as u8, (mixed >> 12) as u8, (mixed >> 16) as u8]
    })
}

/// Runs a program of ffmpeg on a file. `None` if it is not installed.
fn reads(program: &str, file: &[u8], args: &[&str], behind: &[&str]) -> Option<Output> {
    let folder = std::env::temp_dir();
    let thread = std::thread::current();
    let name = thread.name().unwrap_or_default().replace("::", "-");
    let path = folder.join(format!("marf-video-{}-{name}.mp4", std::process::id()));
    std::fs::write(&path, file).unwrap();
    let output = Command::new(program).args(args).arg(&path).args(behind).output();
    std::fs::remove_file(&path).unwrap();
    if output.is_err() {
        println!("skipped: {name} needs `{program}` (apt-get install ffmpeg)");
    }
    let output = output.ok()?;
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.is_empty(), "{program}: {said}");
    Some(output)
}

/// Asserts that ffprobe reports these lines for a file, if it is installed.
pub fn ffprobe_finds(file: &[u8], lines: &[&str]) {
    let asked = "stream=codec_name,width,height,r_frame_rate,nb_frames,pix_fmt,color_range,color_space";
    let args = [
        "-v",
        "error",
        "-show_entries",
        asked,
        "-of",
        "default=noprint_wrappers=1",
        "-i",
    ];
    let Some(probe) = reads("ffprobe", file, &args, &[]) else {
        return;
    };
    let text = String::from_utf8_lossy(&probe.stdout);
    for line in lines {
        assert!(
            text.lines().any(|found| found == *line),
            "{line} is not in\n{text}"
        );
    }
}

/// Noise takes many bits: an encoder that held a rate would drop pictures or spoil them.
pub fn noise_is_encoded_whole() {
    let pictures: Vec<Image<Srgb>> = (0..20).map(|index| noise(96, 64, index)).collect();
    let parsed = parse(&encode(&pictures, settings(24, 24)).unwrap());
    assert_eq!(parsed.samples.len(), 20);
    let least = parsed.samples.iter().map(Vec::len).min().unwrap();
    assert!(least > 96 * 64 / 4, "{least} bytes for a picture of noise");
}

/// Returns the digest of a file that is the same in any thread.
pub fn digest_of_any_thread() -> String {
    let file = move || Digest::from_content(&encode(&pictures(100, 60, 50), settings(24, 24)).unwrap());
    let threads: Vec<_> = (0..3).map(|_| std::thread::spawn(file)).collect();
    let found: Vec<Digest> = threads.into_iter().map(|thread| thread.join().unwrap()).collect();
    assert!(found.iter().all(|digest| *digest == file()), "{found:?}");
    found[0].short()
}
