//! Photos per CPU second: decoding alone, and decoding with the measures of all filters, on one thread.
//!
//! usage: cargo bench -p marf-filter --bench photos [-- FOLDER...]; default: photos of 1440 x 1920 made here.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a bench that a person runs"
)]

use std::{collections::BTreeMap, fs, hint::black_box, time::Instant};

use marf_cache::manifest::Row;
use marf_filter::{measure_photo, tables};
use marf_scene::{Image, Photo};
use marf_stage::harness::Harness;
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

/// A clock of the CPU time of this thread, where the system has one (Linux); else of the wall time.
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
    let rows: Vec<Row> = photos
        .iter()
        .enumerate()
        .map(|(index, bytes)| Row {
            id: index.to_string(),
            blobs: BTreeMap::from([("image".to_owned(), harness.put(bytes))]),
            facts: serde_json::Value::Null,
        })
        .collect();
    let blur = STAGES.iter().find(|stage| stage.name == "blur").unwrap();
    let bound = (blur.bind)(serde_json::json!({})).unwrap();
    let Work::Map(survey) = bound.work() else {
        unreachable!("blur is a map")
    };
    let survey: &dyn Measure = survey;
    let mut times = [Vec::new(), Vec::new()];
    for _ in 0..ROUNDS {
        let start = Clock::now();
        photos
            .iter()
            .for_each(|bytes| drop(black_box(Photo::decode_validated(bytes))));
        times[0].push(start.seconds() / photos.len() as f64);
        let start = Clock::now();
        rows.iter()
            .for_each(|row| drop(black_box(survey.measure(&harness.ctx(), row))));
        times[1].push(start.seconds() / photos.len() as f64);
    }
    times.iter_mut().for_each(|times| times.sort_by(f64::total_cmp));
    println!("{name}: {} photos, {ROUNDS} rounds, one thread", photos.len());
    for (what, times) in ["decoding", "decoding and all measures"].iter().zip(&times) {
        let rate = |seconds: f64| 1.0 / seconds;
        println!(
            "  {what}: {:.1} / {:.1} / {:.1} photos/s (min / median / max)",
            rate(times[ROUNDS - 1]),
            rate(times[ROUNDS / 2]),
            rate(times[0])
        );
    }
    let share = times[0][ROUNDS / 2] / times[1][ROUNDS / 2];
    println!(
        "  all of it runs at {:.0} % of the speed of decoding",
        100.0 * share
    );
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
