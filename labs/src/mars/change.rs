//! `true-change`: what changes on the built-in Mars, and how much of it photos show.

use marf_demo::{Demo, DemoOptions};
use nalgebra::Vector3;
use rayon::prelude::*;

use super::truth::Known;
use crate::output::{Result, print_line};

/// Distance between the places that are looked at, metres.
const STEP_M: f64 = 0.01;
/// Half the side of the square around the change, metres.
const REACH_M: f64 = 3.0;
/// Middle of the compared square, metres in the site.
const MIDDLE_M: [f64; 2] = [6.0, 2.5];
/// Least change of height, metres: what rises by less is sand that leans on the stone.
const LEAST_M: f64 = 0.03;
/// Least change of red over green, as a factor: shade on the sand around the stone changes less.
const LEAST_FACTOR: f64 = 1.03;
/// A photo shows a place that is at this share of the distance it shows there.
const SAME: f64 = 0.005;

/// The good photos of a time.
struct Time {
    sol: u32,
    photos: Vec<Known>,
}

impl Time {
    fn new(demo: &Demo, sols: &[u32]) -> Result<Self> {
        let mut photos = Vec::new();
        for sol in sols {
            for photo in demo.ground_truth(*sol)?.photos {
                let ranges = demo.ranges(*sol, &photo.file)?;
                photos.push(Known { photo, ranges });
            }
        }
        let sol = *sols.first().ok_or("a time without a sol")?;
        Ok(Self { sol, photos })
    }

    /// Returns whether a photo shows a place (metres in the site, height up).
    fn shows(&self, [x_m, y_m]: [f64; 2], height_m: f64) -> bool {
        let place = Vector3::new(x_m, y_m, -height_m);
        let mut found = self.photos.iter().filter_map(|known| known.distances(&place));
        found.any(|found| (found.place_m - found.shown_m).abs() <= SAME * found.place_m)
    }
}

/// What changes at a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Higher,
    Colour,
    Shadow,
}

/// A place that changed.
struct Changed {
    kind: Kind,
    /// x, y and the change of height, metres.
    at: [f64; 3],
    is_seen: bool,
}

/// Returns whether two lights have different colours.
fn is_other(old: [f64; 3], new: [f64; 3]) -> bool {
    let factor = (new[0] / new[1]) / (old[0] / old[1]);
    !(1.0 / LEAST_FACTOR..LEAST_FACTOR).contains(&factor)
}

fn changed(demo: &Demo, before: &Time, after: &Time, place: [f64; 2]) -> Result<Option<Changed>> {
    let [x, y] = place;
    let (old, new) = (
        demo.from_above(before.sol, x, y)?,
        demo.from_above(after.sol, x, y)?,
    );
    let rise = new.height_m - old.height_m;
    let kind = if rise.abs() > LEAST_M {
        Kind::Higher
    } else if old.is_shaded != new.is_shaded {
        Kind::Shadow
    } else if is_other(old.light, new.light) {
        Kind::Colour
    } else {
        return Ok(None);
    };
    Ok(Some(Changed {
        kind,
        at: [x, y, rise],
        is_seen: before.shows(place, old.height_m) && after.shows(place, new.height_m),
    }))
}

/// Prints what changes between two times, by kind.
pub fn change(before: &[u32], after: &[u32]) -> Result {
    let first = *after.first().ok_or("name a sol after the change")?;
    let demo = Demo::new(DemoOptions::default())?.with_change(first)?;
    let (before, after) = (Time::new(&demo, before)?, Time::new(&demo, after)?);
    let steps = (REACH_M / STEP_M) as i32;
    let rows = (-steps..steps).into_par_iter();
    let places = rows.flat_map_iter(|row| (-steps..steps).map(move |column| [row, column]));
    let found: Vec<Option<Changed>> = places
        .map(|[row, column]| {
            let place = [
                MIDDLE_M[0] + f64::from(row) * STEP_M,
                MIDDLE_M[1] + f64::from(column) * STEP_M,
            ];
            changed(&demo, &before, &after, place)
        })
        .collect::<Result<_>>()?;
    for (kind, name) in [
        (Kind::Higher, "higher"),
        (Kind::Colour, "colour"),
        (Kind::Shadow, "shadow"),
    ] {
        let places: Vec<&Changed> = found.iter().flatten().filter(|one| one.kind == kind).collect();
        let area_m2 = |places: usize| places as f64 * STEP_M * STEP_M;
        let mean = |axis: usize| places.iter().map(|one| one.at[axis]).sum::<f64>() / places.len() as f64;
        let seen = places.iter().filter(|one| one.is_seen).count();
        print_line(&format!(
            "{name}: {:.3} m² at x {:.2}, y {:.2}, by {:.3} m. Photos of both times show {:.3} m²",
            area_m2(places.len()),
            mean(0),
            mean(1),
            mean(2),
            area_m2(seen),
        ));
    }
    Ok(())
}
