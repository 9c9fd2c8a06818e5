//! `marf calibrate DIR`: what it writes beside transforms.json, what it prints, and what its errors advise.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

mod common;

use std::path::Path;

use common::marf;

/// Three photos in a row, and their cameras in a transforms.json that also names a photo that is not there.
fn photos() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos/images");
    std::fs::create_dir_all(&folder).unwrap();
    for number in 0..4_u32 {
        let picture = image::RgbImage::from_fn(32, 24, |x, y| {
            image::Rgb([x * 7 + number, y * 10, x * y % 256].map(|value| value as u8))
        });
        picture.save(folder.join(format!("{number}.png"))).unwrap();
    }
    let frame = |number: u32| {
        let matrix = [[1, 0, 0, number], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]];
        serde_json::json!({"file_path": format!("images/{number}.png"), "transform_matrix": matrix})
    };
    let transforms = serde_json::json!({
        "camera_model": "OPENCV", "w": 32, "h": 24, "fl_x": 30.5, "fl_y": 31.0, "cx": 16.0, "cy": 12.0,
        "k1": 0.1, "k2": -0.05, "p1": 0.001, "p2": 0.0,
        "frames": [frame(0), frame(1), frame(2), frame(9)],
    });
    write(
        &dir.path().join("photos/transforms.json"),
        transforms.to_string().as_bytes(),
    );
    dir
}

fn write(path: &Path, bytes: &[u8]) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, bytes).unwrap();
}

fn json(path: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

const IMPORT: [&str; 6] = [
    "calibrate",
    "photos",
    "--method",
    "import",
    "--out",
    "out/transforms.json",
];

#[test]
fn it_writes_what_other_programs_read_and_prints_how_it_went() {
    let dir = photos();
    let ran = marf(dir.path(), &IMPORT).exits(0);
    for line in [
        "registered   3 of 4 photos",
        "1 not: transforms.json has no camera for it",
        "mean error   not measured",
        "scale        no scale",
        "out/sparse/0/images.bin",
    ] {
        assert!(ran.stdout.contains(line), "`{line}` is not in\n{}", ran.stdout);
    }
    let out = dir.path().join("out");
    for file in [
        "transforms.json",
        "metrics.json",
        "sparse/0/points3D.bin",
        "points.ply",
    ] {
        assert!(out.join(file).is_file(), "{file}");
    }
    assert_eq!(json(&out.join("metrics.json"))["totals"]["registered"], 3);
}

#[test]
fn its_colmap_model_places_the_photos_where_its_transforms_do() {
    let dir = photos();
    marf(dir.path(), &IMPORT).exits(0);
    let other = dir.path().join("other");
    std::fs::create_dir_all(other.join("sparse")).unwrap();
    std::fs::rename(dir.path().join("photos/images"), other.join("images")).unwrap();
    std::fs::rename(dir.path().join("out/sparse/0"), other.join("sparse/0")).unwrap();
    let again = [
        "calibrate",
        "other",
        "--method",
        "import",
        "--out",
        "again/transforms.json",
    ];
    marf(dir.path(), &again).exits(0);
    let [first, second] = ["out", "again"].map(|folder| {
        let mut scene = json(&dir.path().join(folder).join("transforms.json"));
        // The mark names the run, and these are two.
        let mark = scene.as_object_mut().unwrap().remove("marf");
        assert!(mark.is_some(), "{scene}");
        scene.to_string()
    });
    assert!(first.contains("\"../photos/images/0.png\""), "{first}");
    assert_eq!(first.replace("../photos/", "../other/"), second);
}

#[test]
fn photos_are_found_from_where_the_file_stands_with_and_without_their_lens() {
    let dir = photos();
    for (out, more) in [
        ("out/deep/a.json", None),
        ("straight/a.json", Some("--undistort")),
    ] {
        let args = ["calibrate", "photos", "--method", "import", "--out", out];
        marf(dir.path(), &args.into_iter().chain(more).collect::<Vec<_>>()).exits(0);
        let file = dir.path().join(out);
        let scene = json(&file);
        for frame in scene["frames"].as_array().unwrap() {
            let photo = file.parent().unwrap().join(frame["file_path"].as_str().unwrap());
            let photo = image::open(&photo).unwrap_or_else(|error| panic!("{}: {error}", photo.display()));
            assert_eq!(
                (&scene["w"], &scene["h"]),
                (&photo.width().into(), &photo.height().into()),
                "{out}"
            );
        }
        assert_eq!(scene["k1"] == 0.0, more.is_some(), "{scene}");
        marf(dir.path(), &["audit", out]).exits(0);
    }
    // Pictures without the lens would lie where the photos do.
    let over = [
        "calibrate",
        "photos",
        "--method",
        "import",
        "--undistort",
        "--out",
        "photos/a.json",
    ];
    let ran = marf(dir.path(), &over).exits(2);
    assert!(ran.stderr.contains("is one of the photos"), "{}", ran.stderr);
}

#[test]
fn hints_are_arguments_of_the_verb() {
    let dir = photos();
    let text = std::fs::read(dir.path().join("photos/transforms.json")).unwrap();
    write(&dir.path().join("photos/sparse/transforms.json"), &text);
    let ran = marf(dir.path(), &IMPORT).exits(0);
    let passed = "not used: `sparse/transforms.json`";
    assert!(ran.stdout.contains(passed), "{}", ran.stdout);
    let chosen = [&IMPORT[..], &["--set", "calibrate.file=transforms.json"]].concat();
    marf(dir.path(), &chosen).exits(0);
    let ran = marf(dir.path(), &["calibrate", "nowhere", "--method", "import"]).exits(1);
    assert!(
        ran.stderr.contains("hint: set DIR to the folder"),
        "{}",
        ran.stderr
    );
}
