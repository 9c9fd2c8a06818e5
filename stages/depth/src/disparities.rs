//! Disparities of a rectified pair: matching, refinement, classes.

use marf_numeric::InstructionSet;
use thiserror::Error;

use crate::raster::{Picture, Raster};
use crate::refine::{self, Planes};
use crate::search::Search;
use crate::winner::NONE;
use crate::{clean, levels, tuning};

/// What is known about a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Class {
    /// No disparity.
    None = 0,
    /// The two pictures of the pair agree.
    Pair = 1,
    /// Further photos agree. One pair alone never says so.
    Confirmed = 2,
    /// The two pictures agree, but a jump to another surface is at most two pixels away.
    Edge = 3,
    /// Pairs of a photo give different depths: it has none. What moved between the photos does that, and so do wrong matches.
    Differs = 4,
    /// No depth: the pixel shows sky.
    Sky = 5,
}

/// Disparities of the left picture. All rasters have its size.
#[derive(Debug, Clone, PartialEq)]
pub struct Disparities {
    /// Pixels, 0 where the class is [`Class::None`].
    pub disparity: Raster<f32>,
    /// Change of the disparity from one pixel to the next to the right, in [-2, 2].
    pub slope_x: Raster<f32>,
    /// Change of the disparity from one pixel to the next below, in [-2, 2].
    pub slope_y: Raster<f32>,
    /// One standard deviation of the disparity, in pixels, 0 where the class is [`Class::None`].
    pub sigma: Raster<f32>,
    /// What is known.
    pub class: Raster<Class>,
}

impl Disparities {
    /// Returns the share of pixels that have a disparity, in [0, 1].
    pub fn share(&self) -> f64 {
        let known = self
            .class
            .values
            .iter()
            .filter(|class| **class != Class::None)
            .count();
        known as f64 / self.class.values.len() as f64
    }
}

/// The left picture seems to be the right one.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error(
    "{:.1} % of the pixels match as given and {:.1} % with left and right exchanged. Exchange the pictures",
    100.0 * given, 100.0 * exchanged
)]
pub struct Swapped {
    /// Share of pixels with a disparity, in [0, 1].
    pub given: f64,
    /// The same with left and right exchanged, at a coarser level.
    pub exchanged: f64,
}

/// Below this share of matches, the exchanged pair is tried. Chance gives a swapped pair up to a quarter.
const FEW_MATCHES: f64 = 0.35;

/// From this share of matches on, and with twice as many as the given pair, the exchanged pair is the right one.
const MANY_MATCHES: f64 = 0.4;

/// The exchanged pair is tried on pictures of at most this many pixels.
const TRIAL_PIXELS: usize = 1 << 17;

/// Returns the disparities of the left picture of a rectified pair.
///
/// Memory is at most 192 MiB for the coarsest level, which tries all disparities, and about 150 bytes a pixel for the
/// others. Large pictures have to be matched in parts: there are no tiles.
///
/// # Extremes
/// Masked pixels, and most without texture or hidden from one camera, have no disparity. Constant margins of both pictures
/// match each other: mask them before. A pair without any match is not an error.
///
/// # Errors
/// Hardly anything matches until left and right are exchanged.
///
/// # Panics
/// If the pictures differ in size or have no pixel, or if the search is empty or too large: a mistake of the caller.
pub fn match_pair(left: &Picture, right: &Picture, search: Search) -> Result<Disparities, Swapped> {
    match_pair_on(InstructionSet::best(), left, right, search)
}

pub(crate) fn match_pair_on(
    set: InstructionSet,
    left: &Picture,
    right: &Picture,
    search: Search,
) -> Result<Disparities, Swapped> {
    let size = [left.grey.width, left.grey.height];
    assert_eq!(
        size,
        [right.grey.width, right.grey.height],
        "pictures that differ in size"
    );
    assert!(!size.contains(&0), "pictures without pixels");
    assert!(search.is_within_limits(), "{search:?}");
    let pair = [left, right];
    let matched = levels::coarse_to_fine(set, pair, search);
    let given = known_share(&matched);
    if given < FEW_MATCHES {
        let exchanged = exchanged_share(set, pair, search);
        if exchanged >= MANY_MATCHES.max(2.0 * given) {
            return Err(Swapped { given, exchanged });
        }
    }
    let planes = refine::refine(set, pair, matched.clone());
    Ok(classify(planes, &matched))
}

/// Returns the share of pixels with a disparity when left and right are exchanged.
fn exchanged_share(set: InstructionSet, pair: [&Picture; 2], search: Search) -> f64 {
    let [left, right] = pair;
    if left.grey.values.len() > TRIAL_PIXELS {
        let halves = pair.map(Picture::halved);
        return exchanged_share(set, [&halves[0], &halves[1]], search.halved());
    }
    known_share(&levels::coarse_to_fine(set, [right, left], search))
}

fn known_share(disparity: &Raster<f32>) -> f64 {
    let known = disparity.values.iter().filter(|value| **value != NONE).count();
    known as f64 / disparity.values.len() as f64
}

/// Drops what the fit made unsure, and finds edges.
fn classify(planes: Planes, matched: &Raster<f32>) -> Disparities {
    let Planes {
        mut disparity,
        mut slope_x,
        mut slope_y,
        mut sigma,
    } = planes;
    for (i, value) in disparity.values.iter_mut().enumerate() {
        let drift = (*value - matched.values[i]).abs();
        if *value != NONE && (sigma.values[i] > tuning::SIGMA_MOST_PX || drift > tuning::DRIFT_PX) {
            *value = NONE;
        }
    }
    clean::remove_islands(&mut disparity, tuning::ISLAND);
    let mut class = Raster::like(&disparity, Class::Pair);
    for y in 0..disparity.height {
        for x in 0..disparity.width {
            if clean::beside_a_jump(&disparity, x, y) {
                class.values[y * disparity.width + x] = Class::Edge;
            }
        }
    }
    for (i, value) in disparity.values.iter_mut().enumerate() {
        if *value == NONE {
            *value = 0.0;
            slope_x.values[i] = 0.0;
            slope_y.values[i] = 0.0;
            sigma.values[i] = 0.0;
            class.values[i] = Class::None;
        }
    }
    Disparities {
        disparity,
        slope_x,
        slope_y,
        sigma,
        class,
    }
}
