//! CPU time a photo, on one thread: decoding, the measure of each filter, and all of it from one decode.
//!
//! usage: cargo bench -p marf-filter --bench photos [-- FOLDER...]. Default: synthetic photos of 1440 x 1920.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a bench that a person runs"
)]

use std::{fs, hint::black_box, time::Instant};

use marf_filter::{measure_photo, tables};
use marf_scene::{Image, Photo};
use marf_stage::{Table, harness::Harness};
use pictures::{dynamic, jpeg, noise};

#[path = "../tests/common/pictures.rs"]
mod pictures;

const ROUNDS: usize = 5;

fn main() {
    let folders = std::env::args().skip(1).filter(|arg| !arg.starts_with("--"));
    let folders: Vec<String> = folders.collect();
    if folders.is_empty() {
        report("made here", &(0..8).map(made).collect::<Vec<_>>());
    }
    for folder in folders {
        let mut paths: Vec<_> = fs::read_dir(&folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect();
        paths.sort();
        let photos = paths.iter().map(|path| fs::read(path).unwrap());
        report(
            &folder,
            &photos
                .filter(|bytes| Photo::decode(bytes).is_ok())
                .collect::<Vec<_>>(),
        );
    }
}

/// CPU time of this thread where the system reports it (Linux), or wall time.
struct Clock {
    wall: Instant,
    on_core_ns: Option<u64>,
}

impl Clock {
    fn now() -> Self {
        Self {
            wall: Instant::now(),
            on_core_ns: Self::on_core_ns(),
        }
    }

    fn on_core_ns() -> Option<u64> {
        let text = fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        text.split_whitespace().next()?.parse().ok()
    }

    fn seconds(&self) -> f64 {
        match self.on_core_ns.zip(Self::on_core_ns()) {
            Some((from, to)) => (to - from) as f64 * 1e-9,
            None => self.wall.elapsed().as_secs_f64(),
        }
    }
}

fn report(name: &str, photos: &[Vec<u8>]) {
    let harness = Harness::default();
    let decoded: Vec<Photo> = photos.iter().map(|bytes| Photo::decode(bytes).unwrap()).collect();
    let measure = |photo: &Photo, wanted: &[Table]| {
        drop(black_box(measure_photo(&harness.ctx(), photo, wanted).unwrap()));
    };
    println!(
        "{name}: {} photos, {ROUNDS} rounds, one thread, ms a photo: min / median / max",
        photos.len()
    );
    let time = |what: &str, work: &dyn Fn(usize)| {
        let mut times: Vec<f64> = (0..ROUNDS)
            .map(|_| {
                let start = Clock::now();
                (0..photos.len()).for_each(work);
                start.seconds() * 1e3 / photos.len() as f64
            })
            .collect();
        times.sort_by(f64::total_cmp);
        println!(
            "  {what}: {:.2} / {:.2} / {:.2}",
            times[0],
            times[ROUNDS / 2],
            times[ROUNDS - 1]
        );
    };
    time("decoding with the check of extract", &|at| {
        drop(black_box(Photo::decode(&photos[at])))
    });
    time("decoding of what was checked", &|at| {
        drop(black_box(Photo::decode_validated(&photos[at])))
    });
    for table in tables() {
        time(&format!("{} alone", table.name), &|at| {
            measure(&decoded[at], &[table])
        });
    }
    time("all measures", &|at| measure(&decoded[at], &tables()));
    time("check and all measures from one decode", &|at| {
        measure(&Photo::decode(&photos[at]).unwrap(), &tables());
    });
}

/// Returns a photo of 1440 x 1920 with detail of several sizes, as JPEG of quality 92.
fn made(seed: u32) -> Vec<u8> {
    let image = Image::from_fn(1440, 1920, |x, y| {
        let sum: u32 = [(64, 4), (9, 4), (1, 1)]
            .map(|(cell, weight)| weight * u32::from(noise(x / cell, y / cell, seed)))
            .iter()
            .sum();
        let shade = (sum / 12) as u8;
        [1.0, 0.8, 0.6].map(|tint| (f32::from(shade) * tint) as u8)
    });
    jpeg(&dynamic(&image), 92)
}
