//! Picks pairs of points in photos of a run of the built-in Mars as a user of `marf view` would, with their true distance, a JSON line a
//! pair: `cargo run --release -p marf-demo --example true_pairs -- out/train/scene.json 100 5`, the last the largest distance from
//! the photo, metres. `benches/distances.py` asks a running `marf view` for the distance of each.
//!
//! Both points of a pair are in one photo, at random pixels at which it shows ground, and at least 20 cm from each other. The true points are
//! carried into the scene by the similarity that aligns its cameras with the true ones: only the pixels depend on that, no distance.

mod truth;

use std::{error::Error, fs, io::Write};

use marf_demo::{Demo, DemoOptions};
use marf_numeric::Rng;
use marf_scene::{Frame, Scene};
use nalgebra::{Matrix3, Vector2, Vector3};
use serde_json::json;
use truth::{Known, alignment, true_photos};

/// Points nearer to each other are no pair, metres.
const LEAST_M: f64 = 0.2;
/// Draws after which the photos are said to show too little.
const MOST_DRAWS: usize = 100_000;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let scene = Scene::decode(&fs::read(arguments.next().ok_or("name a scene")?)?)?;
    let count: usize = arguments.next().ok_or("say how many pairs")?.parse()?;
    let reach_m: f64 = arguments
        .next()
        .map_or(Ok(f64::INFINITY), |reach| reach.parse())?;
    let demo = Demo::new(DemoOptions::default())?;
    let photos = true_photos(&demo, &scene)?;
    let (scaled, moved) = alignment(&scene, &photos);
    let into_world = (
        scaled.try_inverse().ok_or("the cameras stand at one place")?,
        moved,
    );
    let mut rng = Rng::new(0);
    let mut stdout = std::io::stdout().lock();
    let mut found = 0;
    for _ in 0..MOST_DRAWS {
        if found == count {
            return Ok(());
        }
        let photo = rng.below(photos.len() as u64) as usize;
        let (frame, known) = (&scene.frames[photo], &photos[photo]);
        let mut pick = || point(&mut rng, known, frame, reach_m, &into_world);
        let (Some((a, at)), Some((b, to))) = (pick(), pick()) else {
            continue;
        };
        let true_m = (a - b).norm();
        if true_m < LEAST_M {
            continue;
        }
        found += 1;
        let line = json!({"camera": frame.camera, "cam_from_world": frame.cam_from_world, "pixels": [at, to], "true_m": true_m});
        writeln!(stdout, "{line}")?;
    }
    Err(
        format!("{found} pairs in {MOST_DRAWS} draws: the photos show too little ground within {reach_m} m")
            .into(),
    )
}

/// Returns a true point of a photo and the pixel of the scene's camera that shows it; none where the photo shows sky or what is too far.
fn point(
    rng: &mut Rng,
    (photo, map, _): &Known,
    frame: &Frame,
    reach_m: f64,
    (turned, moved): &(Matrix3<f64>, Vector3<f64>),
) -> Option<(Vector3<f64>, [u32; 2])> {
    let [column, row] = [map.width, map.height].map(|side| rng.below(u64::from(side)) as u32);
    let range_m = f64::from(map.range_m[(row * map.width + column) as usize]);
    // In labels whole numbers are centres of pixels.
    let at = Vector2::new(f64::from(column), f64::from(row));
    let ray = photo.site_model.unproject(&at)?;
    let point = (range_m <= reach_m && range_m.is_finite()).then(|| ray.origin + ray.direction * range_m)?;
    let in_cam = frame.cam_from_world.point(&(turned * (point - moved)));
    let pixel = frame.camera.project(&in_cam)?;
    let side = |value: f64, most: u32| (value >= 0.0 && value < f64::from(most)).then_some(value as u32);
    Some((
        point,
        [
            side(pixel.x, frame.camera.width)?,
            side(pixel.y, frame.camera.height)?,
        ],
    ))
}
