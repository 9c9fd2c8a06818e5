//! The kept measurements of time against quality in `benches/front`: the levels of `quality` are points that none beats by more than
//! seeds do.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use std::path::PathBuf;

use marf_field::Quality;
use serde_json::Value;

/// The scenes, each with the spread of the PSNR of a point over seeds, dB, and the settings of each level as measured.
///
/// The spread is the interval that `marf trade --seeds 3` reports for means of three (0.21 for the mock-up, 0.07 for lego), times 1.7
/// for single runs. The settings are steps, on photos of 480 pixels, with the trials if those decide anything.
const MEASURED: [(&str, f64, [&[&str]; 3]); 3] = [
    (
        "mock-up",
        0.36,
        [&[], &["train.steps=4000"], &["train.steps=20000"]],
    ),
    ("lego", 0.12, [&[], &["train.steps=4000"], &["train.steps=20000"]]),
    (
        "demo",
        0.27,
        [&[], &["train.quality=\"standard\""], &["train.steps=20000"]],
    ),
];

/// A measured point: its settings, sorted, mean PSNR in dB and mean seconds.
struct Point {
    sets: Vec<String>,
    psnr: f64,
    seconds: f64,
}

/// The points of a scene. Those with one knob turned at `draft` are as three seeds have them, if these were measured for the same
/// training: then the first run of both files is the same.
fn points(scene: &str) -> Vec<Point> {
    let single = trade(scene);
    let effects = trade(&format!("{scene}-effects"));
    let first_psnr = |trade: &Value| trade["points"][0]["runs"][0]["psnr"].as_f64().unwrap();
    let mut points = match first_psnr(&single) == first_psnr(&effects) {
        true => measured(&effects),
        false => Vec::new(),
    };
    let is_new = |point: &Point| points.iter().all(|known| known.sets != point.sets);
    let new: Vec<Point> = measured(&single).into_iter().filter(is_new).collect();
    points.extend(new);
    points
}

fn trade(name: &str) -> Value {
    let file = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("benches/front/{name}.json"));
    serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap()
}

/// The points that were judged on the same photos as the first, which no knob turns.
fn measured(trade: &Value) -> Vec<Point> {
    let point = |point: &Value| {
        let sets = point["sets"].as_array().unwrap().iter();
        let mut sets: Vec<String> = sets.map(|set| set.as_str().unwrap().to_owned()).collect();
        sets.sort();
        let runs = point["runs"].as_array().unwrap();
        let mean = |key: &str| {
            let values = runs.iter().map(|run| run[key].as_f64().unwrap());
            values.sum::<f64>() / runs.len() as f64
        };
        let judged_by = |point: &Value| point["runs"][0]["judged_by"].clone();
        let is_comparable = !runs.is_empty() && judged_by(point) == judged_by(&trade["points"][0]);
        is_comparable.then(|| Point {
            sets,
            psnr: mean("psnr"),
            seconds: mean("seconds"),
        })
    };
    let points = trade["points"].as_array().unwrap();
    points.iter().filter_map(point).collect()
}

/// Training on few samples of a ray gains PSNR and loses near surfaces, which PSNR does not see: `benches/field.md`.
fn keeps_surfaces(point: &Point) -> bool {
    point.sets.iter().all(|set| !set.contains("ray_samples"))
}

#[test]
fn no_measured_point_beats_a_level_in_time_and_in_quality() {
    for (scene, seeds_db, levels) in MEASURED {
        let points = points(scene);
        for sets in levels {
            let level = points.iter().find(|point| point.sets == sets);
            let level = level.unwrap_or_else(|| panic!("{scene}: {sets:?} was not measured"));
            let beats = |point: &&Point| point.seconds <= level.seconds && point.psnr > level.psnr + seeds_db;
            if let Some(better) = points.iter().filter(|point| keeps_surfaces(point)).find(beats) {
                panic!(
                    "{scene}: {:?} has {:.2} dB in {:.0} s, {sets:?} {:.2} dB in {:.0} s",
                    better.sets, better.psnr, better.seconds, level.psnr, level.seconds
                );
            }
        }
    }
}

/// A level that is changed must be measured again: `benches/time.md` has the commands.
#[test]
fn the_levels_are_those_that_were_measured() {
    let levels = [Quality::Draft, Quality::Standard, Quality::Best];
    assert_eq!(levels.map(Quality::steps), [400, 4_000, 20_000]);
    assert_eq!(Quality::LONGEST_SIDE_PX, 480);
}
