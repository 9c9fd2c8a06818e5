//! A report of real photos: large enough to look at, and to hold the page to its size.

use std::path::PathBuf;

use marf_cache::manifest::Row;
use marf_scene::{Camera, Frame, Photo, PhotoFacts, Point, Pose, Scene, Unplaced, encode_png};
use marf_stage::Verdict;
use serde_json::{Value, json};

use super::fixture::{Store, giving, node, verdict};
use super::*;

fn shared_data() -> PathBuf {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data");
    std::env::var_os("MARF_SHARED_DATA").map_or_else(|| beside.into(), PathBuf::from)
}

fn files_of(folder: &str) -> Vec<(String, PathBuf)> {
    let listed = std::fs::read_dir(shared_data().join(folder))
        .into_iter()
        .flatten();
    let mut files: Vec<PathBuf> = listed.map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| {
        path.extension()
            .is_some_and(|ending| ending == "jpg" || ending == "png")
    });
    files.sort();
    let named = |path: PathBuf| (path.file_name().unwrap().to_string_lossy().into_owned(), path);
    files.into_iter().map(named).collect()
}

fn rows(store: &mut Store) -> Vec<Row> {
    let files: Vec<(String, PathBuf)> = ["rover/images", "m2020_navcam_feed"]
        .iter()
        .flat_map(|folder| files_of(folder))
        .collect();
    let row = |(file, path): (String, PathBuf)| Row {
        id: file.clone(),
        blobs: BTreeMap::from([("image".to_owned(), store.put(&std::fs::read(path).unwrap()))]),
        facts: PhotoFacts {
            file,
            ..PhotoFacts::default()
        }
        .to_json(),
    };
    files.into_iter().map(row).collect()
}

/// A filter that rejects every `nth` photo; what it says is made up, the pictures are not.
fn filter(store: &mut Store, name: &str, upstream: &str, rows: &mut Vec<Row>, nth: usize) -> NodeView {
    let judge = |(index, row): (usize, &Row)| match index % nth == nth - 1 {
        false => verdict(&row.id, "keep"),
        true => Verdict {
            twin: (name == "duplicate").then(|| rows[index - 1].id.clone()),
            score: Some(11.0 + index as f64 / 7.0),
            threshold: Some(25.0),
            reason: format!(
                "{name}: {:.1} is less than the threshold allows",
                11.0 + index as f64 / 7.0
            ),
            ..verdict(&row.id, name)
        },
    };
    let verdicts: Vec<Verdict> = rows.iter().enumerate().map(judge).collect();
    let mut kept = verdicts.iter().map(Verdict::keeps);
    rows.retain(|_| kept.next().unwrap());
    let mut node = node(name, &[upstream]);
    (node.state, node.seconds) = (State::Reused, Some(0.4));
    node.reason = "same key as in an earlier run".to_owned();
    node.params = json!({"threshold": 25.0, "rule": "laplacian"});
    giving(
        node,
        [
            ("photos", store.put_photos(rows.clone())),
            ("verdicts", store.put_verdicts(&verdicts)),
        ],
    )
}

/// The authors' cameras; transforms.json has y up and z backward in the camera.
fn scene() -> Scene {
    let text = std::fs::read(shared_data().join("rover/transforms.json")).unwrap();
    let all: Value = serde_json::from_slice(&text).unwrap();
    let number = |value: &Value| value.as_f64().unwrap();
    let camera = Camera {
        fx_px: number(&all["fl_x"]),
        fy_px: number(&all["fl_y"]),
        ..Camera::pinhole(1440, 1920, 1.0)
    };
    let pose = |matrix: &Value| {
        let rows = [0, 1, 2].map(|row| {
            [(0, 1.0), (1, -1.0), (2, -1.0), (3, 1.0)].map(|(at, sign)| number(&matrix[row][at]) * sign)
        });
        Pose::from(rows).inverse()
    };
    let mut frames: Vec<Frame> = all["frames"]
        .as_array()
        .unwrap()
        .iter()
        .map(|frame| Frame {
            id: frame["file_path"]
                .as_str()
                .unwrap()
                .rsplit('/')
                .next()
                .unwrap()
                .to_owned(),
            file: frame["file_path"].as_str().unwrap().to_owned(),
            image: Digest::of(b""),
            camera,
            cam_from_world: pose(&frame["transform_matrix"]),
            held_out: false,
            error_px: Some(0.7),
        })
        .collect();
    frames.sort_by(|a, b| a.id.cmp(&b.id));
    frames
        .iter_mut()
        .step_by(8)
        .for_each(|frame| frame.held_out = true);
    let point = |index: u32| {
        let (x, y) = (
            f64::from(index % 61) / 30.0 - 1.0,
            f64::from(index / 61 % 47) / 23.0 - 1.0,
        );
        Point {
            position: [x + y * 0.1, y, 0.3 * x * y],
            color: None,
            views: 3,
        }
    };
    Scene {
        frames,
        unplaced: vec![Unplaced {
            id: "frame_00001.jpg".to_owned(),
            reason: "transforms.json has no frame of this file".to_owned(),
        }],
        points: (0..2500).map(point).collect(),
        up: Some([0.0, 0.0, 1.0]),
        metres_per_unit: None,
        method: "import of transforms.json".to_owned(),
    }
}

fn figures(index: usize, id: &str) -> Value {
    json!({"id": id, "name": id.trim_end_matches(".jpg"), "psnr": 24.0 + index as f64 * 0.37, "psnr_paper": 23.1 + index as f64 * 0.3, "ssim": 0.78})
}

/// Photos beside a coarse copy of themselves, as a field of few steps would render them.
fn train(store: &mut Store, rows: &[Row], scene: Digest) -> NodeView {
    let mut train = giving(node("train", &["calibrate", "tune"]), [("scene", scene)]);
    train.upstream[1].0 = "params".to_owned();
    train.seconds = Some(61.3);
    for row in rows.iter().take(6) {
        let photo = Photo::decode(&store.blobs[&row.blobs["image"]])
            .unwrap()
            .image
            .box_reduced(4);
        let coarse =
            marf_scene::Image::from_fn(photo.width, photo.height, |x, y| photo.at(x / 5 * 5, y / 5 * 5));
        let stem = row.id.trim_end_matches(".jpg");
        train.outputs.insert(
            format!("photo/{stem}.png"),
            store.put(&encode_png(&photo).unwrap()),
        );
        train.outputs.insert(
            format!("heldout/{stem}.png"),
            store.put(&encode_png(&coarse).unwrap()),
        );
    }
    let views: Vec<Value> = rows
        .iter()
        .take(6)
        .enumerate()
        .map(|(index, row)| figures(index, &row.id))
        .collect();
    let metrics = json!({"psnr": 25.1, "psnr_paper": 24.2, "ssim": 0.78, "steps": 2000, "rays": 2048000, "samples": 51234567, "loss": 0.0031,
        "scale": 4, "seed": 7, "holdout": "test", "train_photos": 70, "held_out_photos": 10, "config": {"levels": 8, "table_log2": 17}, "views": views});
    let curve: Vec<Value> = [125, 250, 500, 750, 1000, 1250, 1500, 1750, 2000].iter().map(|step| {
        let grown = f64::from(*step).ln();
        json!({"step": step, "rays": step * 1024, "samples": step * 25000, "loss": 1.0 / grown.powi(3), "psnr": 8.0 + 2.2 * grown})
    }).collect();
    giving(
        train,
        [
            ("metrics", store.put_json(&metrics)),
            ("curve", store.put_json(&json!(curve))),
        ],
    )
}

fn bootstrap(store: &mut Store, train: &NodeView) -> NodeView {
    let mut maps = node("bootstrap", &["calibrate", "tune"]);
    maps.children = (0..5)
        .map(|index| ChildView {
            name: format!("member-{index:02}"),
            state: if index > 2 { State::Ran } else { State::Reused },
            seconds: Some(58.0),
        })
        .collect();
    for (name, digest) in &train.outputs {
        let Some(stem) = name
            .strip_prefix("photo/")
            .and_then(|name| name.strip_suffix(".png"))
        else {
            continue;
        };
        let photo = Photo::decode(&store.blobs[digest]).unwrap().image;
        for (index, kind) in ["photo", "mean", "error", "std", "opacity", "total", "depth-std"]
            .into_iter()
            .enumerate()
        {
            let picture = marf_scene::Image::from_fn(photo.width, photo.height, |x, y| {
                photo.at(x, y).map(|value| value / (1 + index as u8))
            });
            maps.outputs.insert(
                format!("maps/{stem}-{kind}.png"),
                store.put(&encode_png(&picture).unwrap()),
            );
        }
    }
    let metrics = json!({"b": 5, "mode": "seeds", "std": 0.0213, "total_sd": 0.031, "opacity_term": 0.004, "unseen_share": 0.012,
        "heldout": {"psnr": 25.8, "psnr_members_mean": 25.0, "ause_mae": 0.29, "ause_mae_random": 0.65, "spearman": 0.51, "coverage": {"sd1": 0.55, "sd2": 0.81, "sd3": 0.9}, "calibration": null},
        "members": [{"seed": 0, "psnr": 25.0, "ssim": 0.77}, {"seed": 1, "psnr": 25.1, "ssim": 0.78}]});
    giving(maps, [("metrics", store.put_json(&metrics))])
}

fn tune(store: &mut Store) -> NodeView {
    let mut tune = node("tune", &["calibrate"]);
    tune.children = (0..6)
        .map(|index| ChildView {
            name: format!("trial-{index:02}"),
            state: State::Reused,
            seconds: Some(21.0),
        })
        .collect();
    let trials: Vec<Value> = (0..6_u32).map(|index| json!({"trial": format!("trial-{index:02}"), "rank": 1 + (index + 3) % 6, "psnr": 24.0 - f64::from((index + 3) % 6) * 0.2, "psnr_paper": 23.0, "ssim": 0.7,
        "params": {"learning_rate": 0.01 / f64::from(index + 1), "levels": 8 + index % 2 * 8}})).collect();
    let scatter = json!({"psnr": [23.4, 23.6], "difference_db": 0.2, "best_minus_default_db": 0.6});
    giving(
        tune,
        [
            ("trials", store.put_json(&json!(trials))),
            ("scatter", store.put_json(&scatter)),
            ("params", store.put_json(&json!({"field": {"levels": 8}}))),
        ],
    )
}

fn film(store: &mut Store, rows: &[Row]) -> Digest {
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::gif::GifEncoder::new_with_speed(&mut bytes, 30);
    for row in rows.iter().take(8) {
        let photo = Photo::decode(&store.blobs[&row.blobs["image"]])
            .unwrap()
            .image
            .box_reduced(6);
        let pixels: Vec<u8> = photo.pixels.as_flattened().to_vec();
        encoder
            .encode(&pixels, photo.width, photo.height, image::ExtendedColorType::Rgb8)
            .unwrap();
    }
    drop(encoder);
    store.put(&bytes)
}

fn run_of_the_rover() -> (Store, Vec<NodeView>) {
    let mut store = Store::default();
    let mut rows = rows(&mut store);
    let mut seen: Vec<Verdict> = rows.iter().map(|row| verdict(&row.id, "keep")).collect();
    seen.push(Verdict {
        score: None,
        threshold: None,
        reason: "JPEG: the end marker FF D9 is missing: the file is cut short".to_owned(),
        ..verdict("<img src=x onerror=alert(1)>.jpg", "decode")
    });
    let outputs = [
        ("photos", store.put_photos(rows.clone())),
        ("verdicts", store.put_verdicts(&seen)),
    ];
    let mut nodes = vec![giving(node("photos", &[]), outputs)];
    nodes[0].stage = "extract".to_owned();
    let mut upstream = "photos";
    for (name, nth) in [
        ("size", 40),
        ("shape", 33),
        ("duplicate", 9),
        ("grayscale", 7),
        ("histogram", 50),
        ("blur", 11),
    ] {
        nodes.push(filter(&mut store, name, upstream, &mut rows, nth));
        upstream = name;
    }
    let scene = store.put(&scene().encode().unwrap());
    let placed = json!({"registered": 92, "error_px": 0.71, "photos": [{"id": "frame_00002.jpg", "registered": true, "matches": 812, "inliers": 640, "error_px": 0.7}]});
    nodes.push(giving(
        node("calibrate", &["blur"]),
        [("scene", scene), ("metrics", store.put_json(&placed))],
    ));
    nodes.push(tune(&mut store));
    nodes.push(train(&mut store, &rows, scene));
    nodes.push(bootstrap(&mut store, &nodes[9].clone()));
    let film = film(&mut store, &rows);
    nodes.push(giving(node("flight", &["train"]), [("video", film)]));
    let mut failed = node("evaluate", &["train"]);
    (failed.state, failed.reason) = (
        State::Failed,
        "views: `all` asks for 92 photos at 480 px: 3.1 GB, at most 2 GB".to_owned(),
    );
    nodes.push(failed);
    (store, nodes)
}

/// Set `MARF_REPORT_OUT` to a file to look at the page.
#[test]
fn a_report_of_134_photos_stays_below_15_megabytes() {
    if files_of("rover/images").is_empty() || files_of("m2020_navcam_feed").is_empty() {
        println!("skipped: a_report_of_134_photos needs ../shared/data");
        return;
    }
    let (store, nodes) = run_of_the_rover();
    let html = store.report(&nodes);
    assert!(html.len() < 15_000_000, "{} bytes", html.len());
    assert!(
        html.matches("<img").count() > 100,
        "{} pictures",
        html.matches("<img").count()
    );
    if let Some(out) = std::env::var_os("MARF_REPORT_OUT") {
        std::fs::write(out, html).unwrap();
    }
}
