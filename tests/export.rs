//! `marf export KIND`: every kind of a surface of a field, and what is refused.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

mod common;

use std::path::Path;
use std::sync::LazyLock;

use common::{Ran, SURFACE, marf};

/// A field of photos whose cameras know no metre and no up.
const WITHOUT_SCALE: &str = r#"name = "unscaled"
[archive.photos]
kind = "folder"
path = "photos"

[node.extract]
archive = "photos"

[node.calibrate]
input = "extract"
cameras = "extract"
method = "import"

[node.train]
input = "calibrate"
steps = 3
"#;
/// Loose, so that a field of few steps has a surface.
const LOOSE: &str = "--cell 0.05 --most-spread 5 --least-photos 1";

/// Returns a folder with a run, which all tests share. No test reads the files of another.
fn trained() -> &'static Path {
    static FOLDER: LazyLock<tempfile::TempDir> = LazyLock::new(|| common::ran("surface", SURFACE));
    FOLDER.path()
}

fn export(folder: &Path, line: &str) -> Ran {
    let args: Vec<&str> = ["export"].into_iter().chain(line.split(' ')).collect();
    marf(folder, &args)
}

#[track_caller]
fn begins_with(file: &Path, magic: &[u8]) {
    let bytes = std::fs::read(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    assert!(bytes.starts_with(magic), "{}: {:?}", file.display(), &bytes[..8]);
}

const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
const TIFF: &[u8] = b"II*\0";

#[test]
fn every_kind_of_a_surface_is_the_format_of_its_ending() {
    let dir = trained();
    let elsewhere = tempfile::tempdir().unwrap();
    let out = elsewhere.path();
    for (kind, file, magic) in [
        ("mesh", "mesh.ply", &b"ply\n"[..]),
        ("mesh", "mesh.glb", b"glTF"),
        ("points", "points.ply", b"ply\n"),
        ("splats", "splats.ply", b"ply\n"),
        ("height", "height.tif", TIFF),
        ("height", "height.png", PNG),
        ("orthophoto", "ortho.tif", TIFF),
        ("orthophoto", "ortho.png", PNG),
    ] {
        let mut args = vec!["export", kind, "--out"];
        let path = out.join(file);
        args.push(path.to_str().unwrap());
        args.extend(LOOSE.split(' '));
        let ran = marf(dir, &args).exits(0);
        assert!(
            ran.stdout.contains(&format!("wrote {}", path.display())),
            "{}",
            ran.stdout
        );
        begins_with(&path, magic);
    }
    for file in [
        "height-spread.tif",
        "height-spread.png",
        "height.pgw",
        "ortho.pgw",
    ] {
        assert!(out.join(file).exists(), "{file}");
    }
}

#[test]
fn an_explicit_default_and_an_omitted_option_give_one_key() {
    let dir = trained();
    let line = "--cell 0.2 --most-spread 5";
    let first = export(dir, &format!("points train --out a.ply {line}")).exits(0);
    assert_eq!(first.done(), ["surface-of-train"], "{}", first.stderr);
    // Two is the default of the first, photos that of the second.
    let explicit = format!("points train --out b.ply {line} --least-photos 2 --color photos");
    let again = export(dir, &explicit).exits(0);
    assert_eq!(again.done(), [""; 0], "{}", again.stderr);
    // The head has the mark of the run.
    let points = |file: &str| {
        let bytes = std::fs::read(dir.join(file)).unwrap();
        let end = bytes
            .windows(10)
            .position(|window| window == b"end_header")
            .unwrap();
        bytes[end..].to_vec()
    };
    assert!(points("a.ply").len() > 1000 && points("a.ply") == points("b.ply"));
    let made = marf(dir, &["audit", "b.ply"]).exits(0).stdout;
    assert!(made.contains("surface-of-train"), "{made}");
}

#[test]
fn depths_are_a_folder_with_a_picture_for_each_photo_trained_on() {
    let dir = trained();
    let said = export(dir, "depth --out depth").exits(0).stdout;
    let pictures: Vec<_> = std::fs::read_dir(dir.join("depth")).unwrap().flatten().collect();
    assert!(pictures.len() >= 10, "{}", pictures.len());
    pictures
        .iter()
        .for_each(|picture| begins_with(&picture.path(), PNG));
    let scene: serde_json::Value =
        serde_json::from_slice(&std::fs::read(dir.join("out/train/scene.json")).unwrap()).unwrap();
    let camera = &scene["frames"][0]["camera"];
    let (width, _) = image::image_dimensions(pictures[0].path()).unwrap();
    assert_eq!(Some(u64::from(width)), camera["width"].as_u64());
    assert!(said.contains("as large as the photos"), "{said}");
}

#[test]
fn an_ending_that_says_something_else_is_refused() {
    let dir = trained();
    let ran = export(dir, "mesh --out x.stl").exits(2);
    assert!(
        ran.stderr.contains("must end with .ply or .glb"),
        "{}",
        ran.stderr
    );
    assert!(!dir.join("x.stl").exists());
}

#[test]
fn a_map_of_an_empty_mesh_says_what_leaves_it_empty() {
    let dir = trained();
    let ran = export(dir, "orthophoto --out empty.tif --cell 0.2 --least-photos 900").exits(1);
    for word in ["the mesh is empty", "--least-photos"] {
        assert!(ran.stderr.contains(word), "{word}: {}", ran.stderr);
    }
    assert!(!dir.join("empty.tif").exists());
}

#[test]
fn a_height_map_of_a_field_without_metres_says_what_gives_them() {
    let dir = common::photos();
    std::fs::write(dir.path().join("pipeline.toml"), WITHOUT_SCALE).unwrap();
    marf(dir.path(), &["run"]).exits(0);
    let line = format!("height --out height.tif {LOOSE}");
    let ran = export(dir.path(), &line).exits(1);
    for word in ["metre", "method = \"sfm\""] {
        assert!(ran.stderr.contains(word), "{word}: {}", ran.stderr);
    }
    assert!(!dir.path().join("height.tif").exists());
}
