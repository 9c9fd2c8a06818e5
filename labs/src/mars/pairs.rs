//! `true-pairs`: pairs of points in photos of a run, with their true distance.
//!
//! Both points of a pair are in one photo, at random pixels at which it shows ground, and at least 20 cm from each other. The true points are
//! carried into the scene by the similarity that aligns its cameras with the true ones: only the pixels depend on that, no distance.

use std::path::Path;

use marf_numeric::Rng;
use marf_scene::Frame;
use nalgebra::Vector3;
use serde_json::json;

use super::truth::{Known, KnownScene, Similarity};
use crate::output::{Result, print_json};

/// Points nearer to each other do not form a pair, metres.
const LEAST_M: f64 = 0.2;
/// Draws after which the photos are said to show too little.
const MOST_DRAWS: usize = 100_000;

/// Prints `count` pairs of points that are at most `reach_m` from the photo.
pub fn pairs(scene: &Path, count: usize, reach_m: f64) -> Result {
    let known = KnownScene::read(scene)?;
    let Similarity { scaled, shift } = known.alignment();
    let turned = scaled.try_inverse().ok_or("the cameras stand at one place")?;
    let world_from_site = Similarity {
        scaled: turned,
        shift: -(turned * shift),
    };
    let mut rng = Rng::new(0);
    let mut found = 0;
    for _ in 0..MOST_DRAWS {
        if found == count {
            return Ok(());
        }
        let photo = rng.below(known.photos.len() as u64) as usize;
        let frame = &known.scene.frames[photo];
        let mut pick = || {
            let point = random_point(&mut rng, &known.photos[photo], reach_m)?;
            Some((point, pixel(frame, &world_from_site.point(&point))?))
        };
        let (Some((a, at)), Some((b, to))) = (pick(), pick()) else {
            continue;
        };
        let true_m = (a - b).norm();
        if true_m < LEAST_M {
            continue;
        }
        found += 1;
        print_json(&json!({
            "camera": frame.camera, "cam_from_world": frame.cam_from_world, "pixels": [at, to], "true_m": true_m,
        }))?;
    }
    let message =
        format!("{found} pairs in {MOST_DRAWS} draws: the photos show too little ground within {reach_m} m");
    Err(message.into())
}

/// Returns the point that a random pixel of a photo shows, or `None` for the sky and for points that are too
/// far.
fn random_point(rng: &mut Rng, known: &Known, reach_m: f64) -> Option<Vector3<f64>> {
    let sides = [known.ranges.width, known.ranges.height];
    let [column, row] = sides.map(|side| rng.below(u64::from(side)) as u32);
    known.point(column, row, reach_m)
}

/// Returns the pixel of a camera that shows a place of the world.
fn pixel(frame: &Frame, place: &Vector3<f64>) -> Option<[u32; 2]> {
    let pixel = frame.camera.project_inside(&frame.cam_from_world.point(place))?;
    Some([pixel.x as u32, pixel.y as u32])
}
