//! Tells what changes on the built-in Mars, as a comparison of two times should find it, and how much of it photos show:
//! `cargo run --release -p marf-demo --example true_change -- 1,2 8,9`.

use std::error::Error;
use std::io::Write;

use marf_demo::{Demo, DemoOptions, RangeMap, TruePhoto};
use nalgebra::Vector3;
use rayon::prelude::*;

/// Distance between the places that are looked at, metres.
const STEP_M: f64 = 0.01;
/// Half the side of the square around the change, metres.
const REACH_M: f64 = 3.0;
/// What is looked at, metres in the site.
const MIDDLE_M: (f64, f64) = (6.0, 2.5);
/// Least change of height, metres: what rises by less is sand that leans on the stone.
const LEAST_M: f64 = 0.03;
/// Least change of red over green, as a factor: shade on the sand around the stone changes less.
const LEAST_FACTOR: f64 = 1.03;
/// A photo shows a place that is at this share of the distance it shows there.
const SAME: f64 = 0.005;

/// The good photos of a time.
struct Time {
    sol: u32,
    photos: Vec<(TruePhoto, RangeMap)>,
}

impl Time {
    fn new(demo: &Demo, sols: &[u32]) -> Result<Self, Box<dyn Error>> {
        let mut photos = Vec::new();
        for sol in sols {
            for photo in demo.ground_truth(*sol)?.photos {
                let ranges = demo.ranges(*sol, &photo.file)?;
                photos.push((photo, ranges));
            }
        }
        let sol = *sols.first().ok_or("a time without a sol")?;
        Ok(Self { sol, photos })
    }

    /// Tells whether a photo shows a place (metres in the site, height up).
    fn shows(&self, x_m: f64, y_m: f64, height_m: f64) -> bool {
        let place = Vector3::new(x_m, y_m, -height_m);
        self.photos.iter().any(|(photo, map)| {
            let Some(pixel) = photo.site_model.project(&place) else {
                return false;
            };
            // In labels whole numbers are centres of pixels.
            let (column, row) = (pixel.x.round(), pixel.y.round());
            let inside =
                column >= 0.0 && row >= 0.0 && column < f64::from(map.width) && row < f64::from(map.height);
            inside && {
                let away = (place - photo.cam_from_site.centre()).norm();
                let shown = f64::from(map.range_m[row as usize * map.width as usize + column as usize]);
                (away - shown).abs() <= SAME * away
            }
        })
    }
}

/// A place that changed.
struct Changed {
    kind: usize,
    /// x, y and the change of height, metres.
    at: [f64; 3],
    is_seen: bool,
}

/// Tells whether two lights have different colours.
fn is_other(old: [f64; 3], new: [f64; 3]) -> bool {
    let factor = (new[0] / new[1]) / (old[0] / old[1]);
    !(1.0 / LEAST_FACTOR..LEAST_FACTOR).contains(&factor)
}

fn changed(
    demo: &Demo,
    before: &Time,
    after: &Time,
    (x, y): (f64, f64),
) -> Result<Option<Changed>, marf_demo::DemoError> {
    let (old, new) = (
        demo.from_above(before.sol, x, y)?,
        demo.from_above(after.sol, x, y)?,
    );
    let rise = new.height_m - old.height_m;
    let kind = match old.is_shaded == new.is_shaded {
        _ if rise.abs() > LEAST_M => 0,
        true if is_other(old.light, new.light) => 1,
        false => 2,
        true => return Ok(None),
    };
    Ok(Some(Changed {
        kind,
        at: [x, y, rise],
        is_seen: before.shows(x, y, old.height_m) && after.shows(x, y, new.height_m),
    }))
}

fn main() -> Result<(), Box<dyn Error>> {
    let sols: Vec<Vec<u32>> = std::env::args()
        .skip(1)
        .map(|sols| sols.split(',').map(str::parse).collect())
        .collect::<Result<_, _>>()?;
    let [before, after] = sols.as_slice() else {
        return Err("name sols before the change and sols from it on, as `1,2 8,9`".into());
    };
    let first = *after.first().ok_or("name a sol after the change")?;
    let demo = Demo::new(DemoOptions::default())?.with_change(first)?;
    let (before, after) = (Time::new(&demo, before)?, Time::new(&demo, after)?);
    let steps = (REACH_M / STEP_M) as i32;
    let places: Vec<(f64, f64)> = (-steps..steps)
        .flat_map(|row| (-steps..steps).map(move |column| (row, column)))
        .map(|(row, column)| {
            (
                MIDDLE_M.0 + f64::from(row) * STEP_M,
                MIDDLE_M.1 + f64::from(column) * STEP_M,
            )
        })
        .collect();
    let found: Vec<Option<Changed>> = places
        .par_iter()
        .map(|place| changed(&demo, &before, &after, *place))
        .collect::<Result<_, _>>()?;
    for (kind, name) in ["higher", "colour", "shadow"].iter().enumerate() {
        let of: Vec<&Changed> = found.iter().flatten().filter(|one| one.kind == kind).collect();
        let mean = [0, 1, 2].map(|axis| of.iter().map(|one| one.at[axis]).sum::<f64>() / of.len() as f64);
        let seen = of.iter().filter(|one| one.is_seen).count();
        writeln!(
            std::io::stdout(),
            "{name}: {:.3} m2 at x {:.2}, y {:.2}, by {:.3} m; photos of both times show {:.3} m2",
            of.len() as f64 * STEP_M * STEP_M,
            mean[0],
            mean[1],
            mean[2],
            seen as f64 * STEP_M * STEP_M,
        )?;
    }
    Ok(())
}
