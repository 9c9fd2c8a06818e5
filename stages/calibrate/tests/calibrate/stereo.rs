//! Real Mastcam-Z pairs: the cameras of the labels against matches of our own features in both eyes.

use std::path::{Path, PathBuf};

use marf_pds::{ProductName, pds4, raw};
use marf_scene::{Cahvor, Photo};
use marf_sfm_features::features::{FeatureOptions, Features, Gray, Mask, extract};
use marf_sfm_features::matching::match_pair;
use nalgebra::{Vector2, Vector3};

use crate::common::shared;

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
/// A match farther than this from the epipolar curve is wrong, px.
const MAX_RESIDUAL_PX: f64 = 40.0;

/// A photo with its features and its camera in the frame of the site.
struct Eye {
    model: Cahvor,
    features: Features,
    motion_counter: Vec<i64>,
}

/// Reads a product with its detached label.
fn eye(folder: &Path, product: &str) -> Eye {
    let files = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let mut files: Vec<PathBuf> = files
        .filter(|path| path.file_stem().is_some_and(|stem| stem == product))
        .collect();
    files.sort();
    let with = |extension: &str| {
        let found = files.iter().find(|path| {
            let own = path.extension().unwrap_or_default();
            own.eq_ignore_ascii_case(extension)
        });
        found.map(|path| std::fs::read(path).unwrap())
    };
    let detached = with("xml").map(|bytes| pds4::read(&bytes).unwrap());
    let name = ProductName::read(product).unwrap();
    let developed = raw::develop(Some(&name), &with("img").unwrap(), detached.as_ref()).unwrap();
    let label = developed.attached.filter(|label| label.prior.is_some());
    let label = label.or(detached).unwrap();
    let (width, height) = (developed.image.width, developed.image.height);
    let prior = label
        .fit_camera(Some(&name), width, height, &mut Vec::new())
        .unwrap();
    let options = FeatureOptions {
        max_features: 8192,
        ..FeatureOptions::default()
    };
    // The 8-bit picture that later stages decode.
    let photo = Photo::decode(&raw::png(&developed.image).unwrap()).unwrap();
    let (gray, mask) = (
        Gray::from_photo(&photo.image, 1),
        Mask::from_photo(&photo.image, 1, None),
    );
    Eye {
        model: prior.model.transformed(&prior.site_from_frame.unwrap()),
        features: extract(&gray, &mask, &options, &|| false).unwrap(),
        motion_counter: prior.motion_counter,
    }
}

/// Returns the distance of a point of `b` from the epipolar curve of a point of `a`, pixels.
///
/// The line is curved by the distortion: 400 chords from 1 m to 10 km, even in 1/range.
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
    let Some(data) = shared("labels alone place the eyes of Mastcam-Z") else {
        return;
    };
    let folder = data.join("m2020_sol0709_img");
    println!(
        "| zoom | baseline m | focal px left, right | matches | right | median px in the left, in the right |"
    );
    for (zoom_mm, left, right, focal_px, [least, most]) in PAIRS {
        let (left, right) = (eye(&folder, left), eye(&folder, right));
        let baseline = (Vector3::from(left.model.c) - Vector3::from(right.model.c)).norm();
        let focal = [&left, &right].map(|eye| eye.model.normalised().unwrap().intrinsics().unwrap().hs);
        let matches = match_pair(&left.features, &right.features);
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
            .filter(|pair| pair[0].max(pair[1]) < MAX_RESIDUAL_PX)
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
        assert_eq!(left.motion_counter[..3], right.motion_counter[..3]);
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
