//! `marf compare`: a place at two times, from the command line.

use std::path::Path;

use serde_json::Value;

use super::common::{Ran, marf, ran};
use super::with_pipeline;

/// The built-in Mars before and after its change, with cameras from the photos.
const TWO_TIMES: &str = r#"name = "two-times"
[archive.demo]
kind = "demo"
sols = "1,8"
width = 160
change = 8
[node.extract]
archive = "demo"
[node.shape]
input = "extract"
min_width = 160
min_height = 120
[node.calibrate]
input = "shape"
method = "sfm"
"#;

fn compare(dir: &Path, more: &[&str]) -> Ran {
    let words = [
        "compare", "--device", "cpu", "--steps", "120", "-b", "2", "--cell", "0.05",
    ];
    marf(dir, &[&words, more].concat())
}

/// Compares the lines for people with changes.json.
fn lines_have_the_numbers_of_the_report(text: &str, report: &Value) {
    let of = |value: &Value, pointer: &str| value.pointer(pointer).and_then(Value::as_f64).unwrap();
    let number = |pointer: &str| of(report, pointer);
    let patches = report["patches"].as_array().unwrap();
    let changed = patches
        .iter()
        .filter(|patch| patch["change"] != "undecided")
        .count();
    let ending = if changed == 1 { "" } else { "es" };
    let mut lines = vec![
        format!(
            "compared {:.2} m² in cells of {:.3} m. Where nothing changed, 90 % of the heights differ by less than {:.3} m",
            number("/compared_m2"),
            number("/cell_m"),
            number("/height/interval")
        ),
        format!(
            "changed  {:.3} m² in {changed} patch{ending}, undecided {:.3} m²",
            number("/changed_m2"),
            number("/undecided_m2")
        ),
    ];
    assert!(!patches.is_empty(), "{report}");
    lines.extend(patches.iter().take(20).map(|patch| {
        let of = |pointer: &str| of(patch, pointer);
        format!(
            " {:.3} m² ({:.3} to {:.3}) at {:.2} m right, {:.2} m up, {:+.3} m ± {:.3}, light x {:.2}",
            of("/area_m2"),
            of("/area_interval_m2/0"),
            of("/area_interval_m2/1"),
            of("/middle_m/0"),
            of("/middle_m/1"),
            of("/height_m/0"),
            of("/height_m/1"),
            of("/brightness")
        )
    }));
    let more = patches.len().saturating_sub(20);
    lines.extend((more > 0).then(|| format!("  and {more} smaller ones in changes.json")));
    for line in lines {
        assert!(text.lines().any(|found| found.ends_with(&line)), "{line}\n{text}");
    }
}

#[test]
fn two_times_are_compared_once_and_written_as_maps() {
    let dir = ran("two-times", TWO_TIMES);
    let dir = dir.path();
    let two = ["--sols", "1", "--sols", "8..=9", "--out", "maps"];
    let ran = compare(dir, &two).exits(0);
    assert!(
        ran.stdout.contains("before   ") && ran.stdout.contains("wrote 11 files to maps"),
        "{}",
        ran.stdout
    );
    let report = std::fs::read(dir.join("maps/changes.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    assert_eq!(
        (&report["before"]["sols"], &report["after"]["sols"]),
        (&vec![1].into(), &vec![8].into())
    );
    assert!(report["compared_m2"].as_f64().unwrap() > 1.0, "{report}");
    lines_have_the_numbers_of_the_report(&ran.stdout, &report);
    let size = [&report["size"][0], &report["size"][1]].map(|side| side.as_u64().unwrap() as u32);
    for name in ["map", "before", "after", "height", "height-interval"] {
        let map = image::open(dir.join(format!("maps/{name}.png"))).unwrap();
        assert_eq!([map.width(), map.height()], size, "{name}");
        let world = std::fs::read_to_string(dir.join(format!("maps/{name}.pgw"))).unwrap();
        assert!(world.starts_with("0.05\n0\n0\n-0.05\n"), "{world}");
    }
    // The same again trains nothing, and a map is known by its bytes.
    let again = compare(dir, &[&two, &["--json"][..]].concat()).exits(0);
    let told: Value = serde_json::from_str(&again.stdout).unwrap();
    assert_eq!(told["changes"]["size"], report["size"]);
    let patches = |report: &Value| report["patches"].as_array().unwrap().len();
    assert_eq!(patches(&told["changes"]), patches(&report));
    let ran = again.stderr.lines().filter(|line| line.starts_with("run "));
    assert_eq!(ran.count(), 0, "{}", again.stderr);
    let audit = marf(dir, &["audit", "maps/map.png"]).exits(0);
    assert!(audit.stdout.contains("changes-of-calibrate"), "{}", audit.stdout);
}

#[test]
fn times_that_cannot_be_compared_are_refused_with_the_way_out() {
    let empty = with_pipeline(TWO_TIMES);
    let dir = ran("two-times", TWO_TIMES);
    let refused_in = |dir: &Path, more: &[&str], code: i32, words: &[&str]| {
        let ran = compare(dir, &[more, &["--out", "maps"]].concat()).exits(code);
        for word in words {
            assert!(ran.stderr.contains(word), "{word}: {}", ran.stderr);
        }
        assert!(!dir.join("maps").exists());
    };
    refused_in(
        empty.path(),
        &["--sols", "1", "--sols", "8"],
        1,
        &["there is no store"],
    );
    let refused = |more: &[&str], code: i32, words: &[&str]| refused_in(dir.path(), more, code, words);
    refused(
        &["--sols", "1"],
        2,
        &["1 times are given", "--sols 1..=2 --sols 8..=9"],
    );
    refused(
        &["--sols", "1..=3", "--sols", "3"],
        2,
        &["sol 3 is in `before` too"],
    );
    refused(&["--sols", "1", "--sols", "latest"], 2, &["latest"]);
    refused(
        &["delta", "--sols", "1", "--sols", "8"],
        2,
        &["delta", "leave the scene out"],
    );
    refused(
        &["--sols", "1", "--sols", "9"],
        1,
        &[
            "after = \"9\": 0 photos of these sols have a camera, a surface needs 4",
            "sols with placed photos: 1, 8",
        ],
    );
}
