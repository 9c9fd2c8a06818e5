//! Exports, opened by public readers: pycolmap, plyfile, GDAL, the Khronos glTF validator, safetensors.
//!
//! Python packages and the validator are installed into `target/readers*`. GDAL is that of the machine. A test whose reader is missing
//! says so and is skipped.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

mod common;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use common::{SURFACE, marf, tools};
use serde_json::{Value, json};

/// Cameras that were written and read differ by rounding to text and back.
const SAME_CAMERA: f64 = 1e-6;
const GLTF_VALIDATOR: &str = "gltf-validator@2.0.0-dev.3.10";

/// Returns a folder with a run and its exports, which all tests share and none changes.
fn exported() -> &'static Path {
    // One that cannot be made fails all tests at once, and is not tried again.
    static FOLDER: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
        let dir = common::ran("surface", SURFACE);
        let surface = "--cell 0.05 --most-spread 5 --least-photos 1";
        for line in [
            "cameras --out cameras".to_owned(),
            format!("mesh --out mesh.ply {surface}"),
            format!("mesh --out mesh.glb {surface}"),
            format!("mesh --out sure.ply --color uncertainty {surface}"),
            format!("points --out points.ply {surface}"),
            format!("height --out height.tif {surface}"),
            format!("height --out again.tif --json {surface}"),
            format!("orthophoto --out ortho.tif {surface}"),
            "splats --out splats.ply --cell 0.1 --pictures splats".to_owned(),
        ] {
            let mut args = vec!["export"];
            args.extend(line.split(' '));
            let said = marf(dir.path(), &args).exits(0).stdout;
            std::fs::write(dir.path().join(format!("{}.said", args[3])), said).unwrap();
        }
        dir
    });
    FOLDER.path()
}

/// Returns the answer of a reader in Python about a file.
fn read(kind: &str, file: &str) -> Option<Value> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/readers");
    let requirements = folder.join("requirements.txt");
    let wanted = std::fs::read_to_string(&requirements).unwrap();
    let install = vec!["-r", requirements.to_str().unwrap()];
    let python = tools::python("readers", &wanted, &[install])?;
    let mut command = Command::new(python);
    tools::json_of(command.args([folder.join("read.py"), PathBuf::from(kind), exported().join(file)]))
}

fn said(file: &str) -> String {
    std::fs::read_to_string(exported().join(format!("{file}.said"))).unwrap()
}

fn is_in_metres(told: &Value) -> bool {
    let comments = told["comments"].as_array().unwrap();
    comments.contains(&json!("unit: metres"))
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn pycolmap_reads_the_cameras_back_as_text_and_binary() {
    let Some(told) = read("cameras", "cameras") else {
        return;
    };
    assert!(told["images"].as_u64().unwrap() >= 10, "{told}");
    assert_eq!(told["images"], told["text_images"]);
    assert_eq!(told["images"], told["frames"]);
    assert_eq!(told["points"][0], told["points"][1]);
    assert_eq!(told["missing"], json!([]));
    assert!(number(&told["worst"]) < SAME_CAMERA, "{told}");
}

#[test]
fn plyfile_reads_mesh_and_points() {
    for (file, faces) in [("mesh.ply", true), ("points.ply", false)] {
        let Some(told) = read("ply", file) else { return };
        let properties = [
            "x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "photos", "spread",
        ];
        assert_eq!(told["properties"], json!(properties), "{file}");
        assert_eq!(told["finite"], true, "{file}");
        assert!(told["vertices"].as_u64().unwrap() > 100, "{file}: {told}");
        assert_eq!(told["faces"].as_u64().unwrap() > 100, faces, "{file}: {told}");
        assert!(is_in_metres(&told), "{file}: {told}");
    }
}

#[test]
fn plyfile_reads_splats_in_the_layout_of_the_reference_code() {
    let Some(told) = read("ply", "splats.ply") else {
        return;
    };
    let properties = [
        "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1",
        "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
    ];
    assert_eq!(told["properties"], json!(properties));
    assert_eq!(told["finite"], true);
    let range = |name: &str| [0, 1].map(|end| number(&told["range"][name][end]));
    // Half of a cell of 0.1 m, and colours within sRGB.
    assert!((range("scale_0")[0] - 0.05_f64.ln()).abs() < 1e-5, "{told}");
    let [darkest, brightest] = range("f_dc_1");
    assert!(
        darkest >= -1.7725 && brightest <= 1.7725 && darkest < brightest,
        "{told}"
    );
    // The field took more than 0.9 of the light there: ln 9 = 2.197. It took at most 0.99: ln 99 = 4.595.
    let [thinnest, densest] = range("opacity");
    assert!(thinnest > 2.19 && densest < 4.6, "{told}");
    assert!(number(&told["rotation_off"]) < 1e-5, "{told}");
    assert!(is_in_metres(&told), "{told}");
    let said = said("splats.ply");
    assert!(
        said.replace(',', "")
            .starts_with(&format!("{} splats", told["vertices"])),
        "{said}"
    );
    for words in ["trained on: PSNR ", "held out: PSNR ", "the sky"] {
        assert!(said.contains(words), "{said}");
    }
    let pictures = std::fs::read_dir(exported().join("splats")).unwrap();
    for picture in pictures {
        let (width, height) = image::image_dimensions(picture.unwrap().path()).unwrap();
        assert!(width > 2 * height, "splats | field");
    }
}

#[test]
fn gdal_reads_the_maps_with_their_transform() {
    let told = said("again.tif");
    let told: Value = serde_json::from_str(&told).unwrap();
    let map = &told["surface"]["map"];
    let pixel_m = number(&map["pixel_m"]);
    for (file, kind) in [
        ("height.tif", "Float32"),
        ("height-spread.tif", "Float32"),
        ("ortho.tif", "Byte"),
    ] {
        let bytes = std::fs::read(exported().join(file)).unwrap();
        assert_eq!(&bytes[..4], b"II*\0", "{file}");
        let mut command = Command::new("gdalinfo");
        let Some(told) = tools::json_of(command.arg("-json").arg(exported().join(file))) else {
            return;
        };
        assert_eq!(told["driverShortName"], "GTiff");
        assert_eq!(told["size"], json!([map["columns"], map["rows"]]), "{file}");
        assert_eq!(told["bands"][0]["type"], kind, "{file}");
        // Of the corner of the first pixel. The report has its centre.
        let half = pixel_m / 2.0;
        let wanted = [
            number(&map["first_m"][0]) - half,
            pixel_m,
            0.0,
            number(&map["first_m"][1]) + half,
            0.0,
            -pixel_m,
        ];
        for (index, wanted) in wanted.iter().enumerate() {
            let found = number(&told["geoTransform"][index]);
            assert!((found - wanted).abs() < 1e-9, "{file}: {told}");
        }
    }
}

#[test]
fn the_khronos_validator_finds_nothing() {
    let Some(modules) = tools::node_modules("readers-gltf", GLTF_VALIDATOR) else {
        return;
    };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/readers/gltf.js");
    let mut command = Command::new("node");
    command
        .env("NODE_PATH", modules)
        .arg(script)
        .arg(exported().join("mesh.glb"));
    let Some(told) = tools::json_of(&mut command) else {
        return;
    };
    for severity in ["numErrors", "numWarnings"] {
        assert_eq!(told["issues"][severity], 0, "{told}");
    }
    assert!(
        told["info"]["totalTriangleCount"].as_u64().unwrap() > 100,
        "{told}"
    );
}

#[test]
fn the_package_safetensors_reads_a_field() {
    let Some(told) = read("safetensors", "out/train/weights.safetensors") else {
        return;
    };
    assert!(told["tensors"].as_object().unwrap().len() > 3, "{told}");
    assert_eq!(told["finite"], true);
    assert!(!told["metadata"].as_array().unwrap().is_empty(), "{told}");
}

#[test]
fn a_mesh_coloured_by_uncertainty_is_the_same_mesh_in_other_colours() {
    let [plain, sure] = ["mesh.ply", "sure.ply"].map(|file| std::fs::read(exported().join(file)).unwrap());
    let said = said("sure.ply");
    assert!(
        said.contains("no bootstrap: the views of the field differ by"),
        "{said}"
    );
    let text = String::from_utf8_lossy(&sure);
    assert!(text.contains("inferno from 0 to"), "{}", &text[..600]);
    let body = |bytes: &[u8]| {
        let end = bytes
            .windows(11)
            .position(|window| window == b"end_header\n")
            .unwrap();
        bytes[end + 11..].to_vec()
    };
    let (plain, sure) = (body(&plain), body(&sure));
    assert_eq!(plain.len(), sure.len());
    assert_eq!(plain[..24], sure[..24], "position and normal of the first vertex");
    assert_ne!(plain[24..27], sure[24..27], "its colour");
}

#[test]
fn splats_refuse_what_they_cannot_show() {
    for (line, words) in [
        ("export splats --out x.splat", "must end with .ply"),
        ("export splats --out x.ply --color uncertainty", "`export mesh`"),
    ] {
        let refused = marf(exported(), &line.split(' ').collect::<Vec<_>>()).exits(2);
        assert!(refused.stderr.contains(words), "{line}: {}", refused.stderr);
    }
}
