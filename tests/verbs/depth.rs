//! `marf depth` on real stereo pairs of a rover.

use std::path::Path;

use marf_scene::Cahvor;
use nalgebra::{Vector2, Vector3};
use serde_json::Value;

use crate::common::{marf, shared};

/// Navcam pairs of two sites.
const PAIRS: [&str; 4] = [
    "NLF_0340_0697121914_417ECM_N0090364NCAM00420_01_195J",
    "NRF_0340_0697121914_417ECM_N0090364NCAM00420_01_195J",
    "NLF_0718_0730679543_043ECM_N0342098NCAM03717_01_195J",
    "NRF_0718_0730679543_043ECM_N0342098NCAM03717_01_195J",
];

fn document(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn stereo_pairs_of_two_sites_are_metric_without_a_key_each_in_its_own_frame() {
    let Some(data) = shared("m2020_navcam_feed") else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    std::fs::create_dir(&folder).unwrap();
    for name in PAIRS {
        for ending in ["jpg", "json"] {
            let file = format!("{name}.{ending}");
            std::fs::copy(data.join(&file), folder.join(&file)).unwrap();
        }
    }
    let said = marf(dir.path(), &["depth", "photos", "--out", "out"]).exits(0);
    assert!(
        said.stdout
            .contains("so the 4 photos of stereo pairs have the cameras of their labels"),
        "{}",
        said.stdout
    );
    for (stop, least) in [("site9-364", 0.05), ("site34-2098", 0.6)] {
        let metrics = document(&dir.path().join("out").join(stop).join("depth.json"));
        assert_eq!(metrics["unit"], "metres", "{stop}");
        assert_eq!(metrics["pairs"].as_array().unwrap().len(), 1, "{stop}");
        // 0.424 m between the eyes of Navcam.
        let baseline = metrics["pairs"][0]["baseline"].as_f64().unwrap();
        assert!((baseline - 0.424).abs() < 0.002, "{stop}: {baseline}");
        // Most of the first pair is sky.
        let share = metrics["share"].as_f64().unwrap();
        assert!(share > least, "{stop}: {share}");
        assert!(
            said.stdout.contains(&format!("{stop:<12} 2 photos, 1 pair, ")),
            "{}",
            said.stdout
        );
    }
}

/// Linear camera of the left photo of the second pair in pixels of 20 x 20, by its record: rover frame, metres.
const LINEAR: Cahvor = Cahvor {
    c: [0.996036, 0.389969, -1.89384],
    a: [0.79263, 0.221977, 0.567873],
    h: [31.63995, 85.668, 36.5567],
    v: [-2.0361, -0.240678, 88.4375],
    o: None,
    r: None,
    e: None,
};
const COLUMNS: u32 = 64;
const LINES: u32 = 48;

/// A label of a product of level ground at the height of the wheels. `record`: of the label that is attached, or nothing.
fn label(kind: &str, bands: u32, record: &str) -> String {
    let vector = |[x, y, z]: [f64; 3]| format!("({x},{y},{z})");
    let Cahvor { c, a, h, v, .. } = LINEAR;
    let [centre, axis, across, down] = [c, a, h, v].map(vector);
    let frame = "REFERENCE_COORD_SYSTEM_NAME = ROVER_NAV_FRAME\nREFERENCE_COORD_SYSTEM_INDEX = (34,2098)";
    format!(
        "PDS_VERSION_ID = PDS3\n{record}\nROVER_MOTION_COUNTER = (34,2098)\n\
         GROUP = DERIVED_IMAGE_PARMS\nDERIVED_IMAGE_TYPE = {kind}\n{frame}\nEND_GROUP = DERIVED_IMAGE_PARMS\n\
         GROUP = GEOMETRIC_CAMERA_MODEL\nMODEL_TYPE = CAHV\nMODEL_COMPONENT_1 = {centre}\nMODEL_COMPONENT_2 = {axis}\n\
         MODEL_COMPONENT_3 = {across}\nMODEL_COMPONENT_4 = {down}\n{frame}\nEND_GROUP = GEOMETRIC_CAMERA_MODEL\n\
         OBJECT = IMAGE\nLINES = {LINES}\nLINE_SAMPLES = {COLUMNS}\nBANDS = {bands}\nSAMPLE_BITS = 32\nSAMPLE_TYPE = IEEE_REAL\n\
         END_OBJECT = IMAGE\nEND\n"
    )
}

/// Ranges of the ground with their rays, `factor` times as far as it is.
fn ground(factor: f64) -> impl Iterator<Item = (f64, Vector3<f64>)> {
    (0..LINES * COLUMNS).map(move |index| {
        let pixel = Vector2::new(f64::from(index % COLUMNS), f64::from(index / COLUMNS));
        let ray = LINEAR.unproject(&pixel).unwrap().direction;
        let range = if ray.z > 0.2 { -LINEAR.c[2] / ray.z } else { 0.0 };
        (factor * range, ray)
    })
}

fn big_endian(values: impl Iterator<Item = f64>) -> Vec<u8> {
    values.flat_map(|value| (value as f32).to_be_bytes()).collect()
}

/// Ranges, with an attached label.
fn range_product() -> Vec<u8> {
    let mut bytes = label("RANGE_MAP", 1, "RECORD_BYTES = 4096\n^IMAGE = 2").into_bytes();
    bytes.resize(4096, b' ');
    bytes.extend(big_endian(ground(1.0).map(|(range, _)| range)));
    bytes
}

/// Coordinates 2 % too far, band by band, without a label.
fn far_coordinates() -> Vec<u8> {
    let of_axis = |axis: usize| {
        big_endian(ground(1.02).map(move |(range, ray)| {
            if range > 0.0 {
                LINEAR.c[axis] + range * ray[axis]
            } else {
                0.0
            }
        }))
    };
    [0, 1, 2].map(of_axis).concat()
}

#[test]
fn depths_are_scored_against_products_of_the_same_photos() {
    let Some(data) = shared("m2020_navcam_feed") else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    let products = dir.path().join("products");
    for folder in [&folder, &products] {
        std::fs::create_dir(folder).unwrap();
    }
    for name in &PAIRS[2..] {
        for ending in ["jpg", "json"] {
            let file = format!("{name}.{ending}");
            std::fs::copy(data.join(&file), folder.join(&file)).unwrap();
        }
    }
    let arguments = [
        "depth",
        "photos",
        "--against",
        "products",
        "--method",
        "labels",
        "--out",
        "out",
    ];
    let none = marf(dir.path(), &arguments).exits(1);
    assert!(
        none.stderr.contains("no depth could be compared with products"),
        "{}",
        none.stderr
    );
    assert!(
        none.stderr.contains("no product of type XYZ, RNG or DSP"),
        "{}",
        none.stderr
    );
    let ranges = "NLM_0718_0730679543_043RNGLN0342098NCAM03717_00_0LLJ02.IMG";
    let strange = "NLM_0719_0730700000_043XYZLN0342098NCAM03717_00_0LLJ02.IMG";
    let broken = "NRM_0718_0730679543_043XYZLN0342098NCAM03717_00_0LLJ02.IMG";
    let far = "NLM_0718_0730679543_043XYZLN0342098NCAM03717_00_0LLJ02.IMG";
    std::fs::write(products.join(ranges), range_product()).unwrap();
    std::fs::write(products.join(strange), range_product()).unwrap();
    std::fs::write(products.join(far), far_coordinates()).unwrap();
    let beside = label("XYZ_MAP", 3, "^IMAGE = \"A.IMG\"");
    std::fs::write(products.join(far).with_extension("LBL"), beside).unwrap();
    std::fs::write(products.join(ranges).with_extension("png"), "a picture to browse").unwrap();
    std::fs::write(products.join(broken), "no label").unwrap();
    let said = marf(dir.path(), &arguments).exits(0).stdout;
    for part in [
        "against      2 of 4 products compared",
        &format!("{strange}: no photo of its camera and time has a camera"),
        &format!("{broken}: no label at the head of the file"),
        "no product   NRF_0718",
        "pixels have a depth. Median difference ",
        " within 3 sigma",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let json = marf(dir.path(), &[&arguments[..], &["--json"]].concat())
        .exits(0)
        .stdout;
    let score: Value = serde_json::from_str(&json).unwrap();
    assert!(score["share"].as_f64().unwrap() > 0.5, "{json}");
    let near = |product: usize| score["products"][product]["median_share"].as_f64().unwrap();
    // Depths are nearer by 1 - 1 / 1.02 than coordinates that are 2 % too far.
    let planted = (1.0 + near(1)) / (1.0 + near(0));
    assert!((planted - 1.0 / 1.02).abs() < 0.002, "{planted}: {json}");
    assert_eq!(score["octaves"][0]["from_m"].as_f64(), Some(2.0), "{json}");
    std::fs::remove_file(products.join(far)).unwrap();
    let json = marf(dir.path(), &[&arguments[..], &["--json"]].concat())
        .exits(0)
        .stdout;
    let score: Value = serde_json::from_str(&json).unwrap();
    // Near the rover, the ground is level. Farther away it falls.
    let near = &score["octaves"][0];
    assert_eq!(near["to_m"].as_f64(), Some(4.0));
    assert!(near["median_share"].as_f64().unwrap().abs() < 0.01, "{json}");
    assert!(near["median_abs_share"].as_f64().unwrap() < 0.02, "{json}");
}
