//! `true-stereo`: the depths of `depth`, and its height map, next to the truth.
//!
//! Covisible ground is what at least one partner of the photo's pairs shows too, at most 20 m away.

use std::{fs, path::Path};

use marf_numeric::upper_median;
use marf_scene::picture::png16::read_quantity;
use marf_schema::depth::{Metrics, PairMetrics, PhotoMetrics};
use marf_stage::Document;
use nalgebra::{Vector2, Vector3};
use serde_json::{Value, json};

use super::truth::{Known, KnownScene};
use crate::output::{Result, print_json};

/// Ground counts up to this distance, metres.
const REACH_M: f64 = 20.0;
/// A photo shows a place if what it shows there is as far, within this share.
const SAME_SHARE: f64 = 0.02;
/// A depth is wrong if it is off by more than this share and 3 standard deviations.
const WRONG_SHARE: f64 = 0.01;

/// What is counted.
#[derive(Default)]
struct Score {
    covisible: usize,
    valid: usize,
    wrong: usize,
    within: [usize; 2],
    errors_px: Vec<f64>,
    error_shares: Vec<f64>,
}

impl Score {
    fn add(&mut self, other: Self) {
        self.covisible += other.covisible;
        self.valid += other.valid;
        self.wrong += other.wrong;
        (0..2).for_each(|i| self.within[i] += other.within[i]);
        self.errors_px.extend(other.errors_px);
        self.error_shares.extend(other.error_shares);
    }

    fn print(self, heights: Option<Value>) -> Result {
        let share = |count: usize, all: usize| count as f64 / all.max(1) as f64;
        print_json(&json!({
            "covisible": self.covisible,
            "valid_share": share(self.valid, self.covisible),
            "median_error_px": upper_median(self.errors_px),
            "median_error_share": upper_median(self.error_shares),
            "wrong_share": share(self.wrong, self.valid),
            "within_1_sigma": share(self.within[0], self.valid),
            "within_2_sigma": share(self.within[1], self.valid),
            "heights": heights,
        }))
    }
}

/// Prints the score of all photos together.
pub fn stereo(scene: &Path, dir: &Path) -> Result {
    let known = KnownScene::read(scene)?;
    let metrics = ["metrics.json", "depth.json"].map(|name| fs::read(dir.join(name)));
    let metrics = Metrics::decode(
        &metrics
            .into_iter()
            .find_map(std::result::Result::ok)
            .ok_or("no metrics.json")?,
    )?;
    let mut all = Score::default();
    for index in 0..metrics.photos.len() {
        all.add(score(&known, &metrics, index, dir)?);
    }
    let heights = metrics.map.as_ref();
    all.print(
        heights
            .map(|map| super::heights::heights(&known, map, dir))
            .transpose()?,
    )
}

fn score(known: &KnownScene, metrics: &Metrics, index: usize, dir: &Path) -> Result<Score> {
    let photo = &metrics.photos[index];
    let partners = partners(known, metrics, photo);
    if partners.is_empty() {
        return Ok(Score::default());
    }
    let values = |folder: &str, name: &str| -> Result<Vec<f32>> {
        let png = fs::read(dir.join(folder).join(format!("{}.png", photo.name)))?;
        let (_, _, values) = read_quantity(&png, name).ok_or("not a picture of depths")?;
        Ok(values)
    };
    let (inverse, sigma) = (
        values("inverse-depth", "inverse-depth")?,
        values("sigma", "sigma")?,
    );
    let frame = &known.scene.frames[index];
    let camera = frame.camera.box_reduced(frame.camera.width / photo.size_px[0]);
    let truth = &known.photos[index];
    let pinhole = truth.pinhole_of_width(photo.size_px[0])?;
    let baselines: Vec<f64> = pairs_of(metrics, photo).map(|pair| pair.baseline).collect();
    let scale = known.alignment().scale();
    let baseline_m = scale * baselines.iter().sum::<f64>() / baselines.len() as f64;
    let mut score = Score::default();
    for (pixel, (inverse, sigma)) in inverse.iter().zip(&sigma).enumerate() {
        let (column, row) = (pixel as u32 % photo.size_px[0], pixel as u32 / photo.size_px[0]);
        let pixel = Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        let ray = camera.unproject(&pixel).ok_or("a pixel without a ray")?;
        let place = truth.point_of_pinhole(&pinhole, &pixel, REACH_M);
        let Some(place) = place.filter(|place| partners.iter().any(|partner| shows(partner, place))) else {
            continue;
        };
        score.covisible += 1;
        if *inverse <= 0.0 {
            continue;
        }
        score.valid += 1;
        // Along the axis, as the picture has it.
        let true_inverse = ray.norm() / (place - truth.photo.cam_from_site.centre()).norm();
        // The scale of the calibration is no error of the depths.
        let (inverse, sigma) = (f64::from(*inverse) / scale, f64::from(*sigma) / scale);
        let error = (inverse - true_inverse).abs();
        score.errors_px.push(error * camera.fx_px * baseline_m);
        score.error_shares.push(error / true_inverse);
        score.wrong += usize::from(error > (3.0 * sigma).max(WRONG_SHARE * true_inverse));
        score.within[0] += usize::from(error <= sigma);
        score.within[1] += usize::from(error <= 2.0 * sigma);
    }
    Ok(score)
}

fn pairs_of<'a>(metrics: &'a Metrics, photo: &'a PhotoMetrics) -> impl Iterator<Item = &'a PairMetrics> {
    let pairs = metrics.pairs.iter();
    pairs.filter(|pair| pair.reason.is_empty() && pair.photos.contains(&photo.name))
}

/// Returns the other photos of the pairs of a photo.
fn partners<'a>(known: &'a KnownScene, metrics: &Metrics, photo: &PhotoMetrics) -> Vec<&'a Known> {
    let others = pairs_of(metrics, photo).flat_map(|pair| &pair.photos);
    let others = others.filter(|name| **name != photo.name);
    let index = |name: &String| metrics.photos.iter().position(|photo| photo.name == *name);
    others.filter_map(|name| known.photos.get(index(name)?)).collect()
}

fn shows(known: &Known, place: &Vector3<f64>) -> bool {
    known.distances(place).is_some_and(|distances| {
        (distances.place_m - distances.shown_m).abs() <= SAME_SHARE * distances.place_m
    })
}
