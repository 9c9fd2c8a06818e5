//! Real Mastcam-Z pairs: what the labels' cameras say of points that our own features find in both eyes.

use std::path::{Path, PathBuf};

use marf_extract::Extract;
use marf_scene::{Cahvor, CameraPrior, Photo, PhotoFacts};
use marf_stage::harness::Harness;
use marf_stage::{Work, define};
use nalgebra::{Vector2, Vector3};

use marf_sfm::features::{FeatureOptions, Features, Gray, Mask, extract};
use marf_sfm::matching::{MatchOptions, match_pair};

/// Zoom, product of the left and of the right eye, focal length, and the median residual measured elsewhere.
const PAIRS: [(u32, &str, &str, f64, [f64; 2]); 3] = [
    (
        34,
        "ZL0_0709_0729888971_069RAD_N0332864ZCAM07114_0340LMA01",
        "ZR0_0709_0729888971_069RAD_N0332864ZCAM07114_0340LMA01",
        4664.0,
        [2.2, 4.3],
    ),
    (
        63,
        "ZL0_0711_0730060145_020RAD_N0332864ZCAM03552_0630LMA01",
        "ZR0_0711_0730060314_988RAD_N0332864ZCAM03552_0630LMA01",
        8583.0,
        [2.2, 4.3],
    ),
    (
        48,
        "ZL0_0711_0730054943_723RAD_N0332864ZCAM03014_048085A02",
        "ZR0_0711_0730054943_723RAD_N0332864ZCAM03014_048085A02",
        6611.0,
        [6.9, 7.6],
    ),
];
/// The residuals were measured with other features.
const RESIDUAL_TOLERANCE_PX: f64 = 0.5;
/// Farther from the line of sight of its partner than this a match is a wrong one, not a pose's error, px.
const WRONG_PX: f64 = 40.0;

/// A photo with its features and its camera in the frame of the site.
struct Eye {
    model: Cahvor,
    features: Features,
    facts: PhotoFacts,
}

fn real(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("MARF_SHARED_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
        PathBuf::from,
    );
    let path = root.join(name);
    if !path.is_dir() {
        println!("skipped: {name} needs ../shared/data");
        return None;
    }
    Some(path)
}

/// Brings all photos of a folder.
fn eyes(path: &Path) -> Vec<(String, Eye)> {
    let harness = Harness::default();
    let stage =
        (define::<Extract>().bind)(serde_json::json!({"archive": {"kind": "folder", "path": path}})).unwrap();
    let Work::Source(source) = stage.work() else {
        panic!("extract is a source")
    };
    let listing = source.list(&harness.ctx()).unwrap();
    let mut eyes = Vec::new();
    for shard in &listing.shards {
        for row in source.fetch(&harness.ctx(), shard.shard).unwrap().rows {
            let facts = PhotoFacts::from_json(&row.facts).unwrap();
            let photo = Photo::decode(&harness.get(&row.blobs["image"]).unwrap()).unwrap();
            let options = FeatureOptions {
                max_features: 8192,
                ..FeatureOptions::default()
            };
            let features = extract(
                &Gray::of(&photo.image, 1),
                &Mask::of(&photo.image, 1, None),
                &options,
            );
            let prior: &CameraPrior = facts.prior.as_ref().unwrap();
            let model = prior.model.transformed(&prior.site_from_frame.unwrap());
            eyes.push((
                row.id.clone(),
                Eye {
                    model,
                    features,
                    facts,
                },
            ));
        }
    }
    eyes
}

/// Distance of a point of `b` from the line on which `b` sees the line of sight of a point of `a`, pixels.
///
/// The line is bent by the lens: 400 chords from 1 m to 10 km, even in 1/range.
fn residual_px(a: &Cahvor, b: &Cahvor, seen_a: &Vector2<f64>, seen_b: &Vector2<f64>) -> Option<f64> {
    let ray = a.unproject(seen_a)?;
    let steps = 400;
    let at = |step: i32| {
        let inverse_m = 1e-4 + (1.0 - 1e-4) * f64::from(step) / f64::from(steps);
        b.project(&(ray.origin + ray.direction / inverse_m))
    };
    let distance = |step: i32| {
        let (from, to) = (at(step)?, at(step + 1)?);
        let along = to - from;
        let share = (seen_b - from).dot(&along) / along.norm_squared();
        Some((from + along * share.clamp(0.0, 1.0) - seen_b).norm())
    };
    (0..steps).filter_map(distance).min_by(f64::total_cmp)
}

/// Keypoints count from the corner of the first pixel, models from its centre.
fn seen(features: &Features, index: u32) -> Vector2<f64> {
    let point = &features.keypoints[index as usize];
    Vector2::new(f64::from(point.x_px) - 0.5, f64::from(point.y_px) - 0.5)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[test]
fn labels_alone_place_the_eyes_of_mastcam_z_as_measured_elsewhere() {
    let Some(path) = real("m2020_sol0709_img") else {
        return;
    };
    let eyes = eyes(&path);
    let eye = |id: &str| &eyes.iter().find(|(own, _)| own == id).unwrap().1;
    println!(
        "| zoom | baseline m | focal px left, right | matches | right | median px in the left, in the right |"
    );
    for (zoom_mm, left, right, focal_px, [least, most]) in PAIRS {
        let (left, right) = (eye(left), eye(right));
        let baseline = (Vector3::from(left.model.c) - Vector3::from(right.model.c)).norm();
        let focal = [left, right].map(|eye| eye.model.normalised().unwrap().intrinsics().unwrap().hs);
        let matches = match_pair(&left.features, &right.features, &MatchOptions::default());
        let both: Vec<[f64; 2]> = matches
            .iter()
            .filter_map(|[a, b]| {
                let (a, b) = (seen(&left.features, *a), seen(&right.features, *b));
                Some([
                    residual_px(&right.model, &left.model, &b, &a)?,
                    residual_px(&left.model, &right.model, &a, &b)?,
                ])
            })
            .collect();
        let good: Vec<&[f64; 2]> = both
            .iter()
            .filter(|pair| pair[0].max(pair[1]) < WRONG_PX)
            .collect();
        let medians = [0, 1].map(|side| median(good.iter().map(|pair| pair[side]).collect()));
        println!(
            "| {zoom_mm} | {baseline:.4} | {:.0}, {:.0} | {} | {} | {:.2}, {:.2} |",
            focal[0],
            focal[1],
            matches.len(),
            good.len(),
            medians[0],
            medians[1]
        );
        assert!(
            (0.2407..=0.2442).contains(&baseline),
            "{zoom_mm} mm: {baseline} m"
        );
        assert!(
            focal.iter().all(|focal| (focal / focal_px - 1.0).abs() < 0.01),
            "{zoom_mm} mm: {focal:?} px"
        );
        assert_eq!(
            left.facts.prior.as_ref().unwrap().motion_counter[..3],
            right.facts.prior.as_ref().unwrap().motion_counter[..3]
        );
        assert!(
            good.len() >= 50 && good.len() * 4 >= both.len() * 3,
            "{zoom_mm} mm: {} of {}",
            good.len(),
            both.len()
        );
        let within = (least - RESIDUAL_TOLERANCE_PX)..=(most + RESIDUAL_TOLERANCE_PX);
        assert!(
            medians.iter().all(|median| within.contains(median)),
            "{zoom_mm} mm: {medians:?}"
        );
    }
}
