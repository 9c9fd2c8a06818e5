//! `marf export KIND --field FILE`: a field is recognised by its content, whatever the name and the folder of its file.
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
const WEIGHTS: &str = "out/train/weights.safetensors";

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
fn every_kind_of_a_surface_takes_a_field_by_its_content() {
    let dir = trained();
    // Neither its name nor its folder identifies it.
    let elsewhere = tempfile::tempdir().unwrap();
    let field = elsewhere.path().join("a copy");
    std::fs::copy(dir.join(WEIGHTS), &field).unwrap();
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
        let mut args = vec!["export", kind, "--field", field.to_str().unwrap(), "--out"];
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
fn depths_are_a_folder_with_a_picture_for_each_photo_trained_on() {
    let dir = trained();
    let said = export(dir, &format!("depth --field {WEIGHTS} --out depth"))
        .exits(0)
        .stdout;
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
fn a_field_of_a_file_gives_the_bytes_of_its_node_and_is_made_once() {
    let dir = trained();
    let wide = "--cell 0.2 --most-spread 5 --least-photos 1";
    let first = export(dir, &format!("points --field {WEIGHTS} --out by-file.ply {wide}")).exits(0);
    assert_eq!(first.done(), ["surface-of-train"]);
    let again = export(dir, &format!("points train --out by-node.ply {wide}")).exits(0);
    assert_eq!(again.done(), Vec::<&str>::new(), "it is the same field");
    let [by_file, by_node] =
        ["by-file.ply", "by-node.ply"].map(|file| std::fs::read(dir.join(file)).unwrap());
    // The run that a file names is that of its own export.
    let body = |bytes: &[u8]| {
        let end = bytes
            .windows(11)
            .position(|window| window == b"end_header\n")
            .unwrap();
        bytes[end..].to_vec()
    };
    assert_eq!(body(&by_file), body(&by_node));
    assert!(body(&by_file).len() > 1000);
    let made = marf(dir, &["audit", "by-file.ply"]).exits(0);
    assert!(made.stdout.contains("surface-of-train"), "{}", made.stdout);
}

#[test]
fn what_is_no_field_of_the_store_is_one_error_with_the_way_out() {
    let dir = trained();
    let whole = std::fs::read(dir.join(WEIGHTS)).unwrap();
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 1;
    for (name, bytes) in [
        ("short.safetensors", &whole[..whole.len() / 2]),
        ("flipped.safetensors", &flipped),
        ("empty.safetensors", b""),
        ("text.safetensors", b"no field"),
    ] {
        std::fs::write(dir.join(name), bytes).unwrap();
    }
    let no_field = ["gave this field", "marf audit FILE"];
    for (line, words) in [
        ("mesh --field short.safetensors --out x.ply", &no_field[..]),
        ("mesh --field flipped.safetensors --out x.ply", &no_field),
        ("points --field empty.safetensors --out x.ply", &no_field),
        ("splats --field text.safetensors --out x.ply", &no_field),
        // Of the same node, and another output of it.
        ("depth --field out/train/scene.json --out x", &no_field),
        (
            "height --field nowhere.safetensors --out x.tif",
            &["cannot be read"],
        ),
        ("orthophoto --field out --out x.tif", &["cannot be read"]),
        (
            "mesh --field out/train/weights.safetensors --run 9 --out x.ply",
            &["no node of run 9 gave this field"],
        ),
        (
            "mesh train --field out/train/weights.safetensors --out x.ply",
            &["cannot be used with"],
        ),
        (
            "mesh --field out/train/weights.safetensors --out x.stl",
            &["must end with .ply or .glb"],
        ),
        // These need what made a field, not the field.
        (
            "cameras --field out/train/weights.safetensors --out x",
            &["unexpected argument '--field'"],
        ),
        (
            "crate x --field out/train/weights.safetensors",
            &["unexpected argument '--field'"],
        ),
    ] {
        let ran = export(dir, line).exits(2);
        for word in words {
            assert!(ran.stderr.contains(word), "{line}: {word}: {}", ran.stderr);
        }
    }
    for left in ["x", "x.ply", "x.tif", "x.stl"] {
        assert!(!dir.join(left).exists(), "{left} is left of what was refused");
    }
}

#[test]
fn a_map_of_an_empty_mesh_says_what_leaves_it_empty() {
    let dir = trained();
    let line = format!("orthophoto --field {WEIGHTS} --out empty.tif --cell 0.2 --least-photos 900");
    let ran = export(dir, &line).exits(1);
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
    let line = format!("height --field {WEIGHTS} --out height.tif {LOOSE}");
    let ran = export(dir.path(), &line).exits(1);
    for word in ["metre", "method = \"sfm\""] {
        assert!(ran.stderr.contains(word), "{word}: {}", ran.stderr);
    }
    assert!(!dir.path().join("height.tif").exists());
}
