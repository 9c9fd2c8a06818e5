//! Losses and decays in addition to the photos, and their weights.

use marf_numeric::grouped;

use super::choice::Choice;
use crate::{Config, DepthSource, View};

/// Fewer photos than this are few: matter is to gather on surfaces before one of them alone explains it.
pub const FEW_PHOTOS: usize = 24;
/// Weights of the distortion loss at the start and at the end, of few photos and of many. `benches/field.md`.
const DISTORTION_OF_FEW: [f64; 2] = [0.03; 2];
const DISTORTION_OF_MANY: [f64; 2] = [0.0, 0.1];
/// Steps for which sparse points pull at most. `benches/field.md`.
const LONGEST_PULL: u32 = 1_000;
/// With this many photos or fewer, and fewer sparse points a photo than this (photos that hardly overlap),
/// tables are pulled to zero, this strongly at the start. `benches/field.md`.
const FEWEST_PHOTOS: usize = 9;
const FEW_POINTS_A_PHOTO: usize = 50;
const TABLE_DECAY_OF_FEWEST: f64 = 1e-5;

/// Returns the weights of the distortion loss at the start and at the end.
pub(super) fn distortion(config: &Config, photos: usize, has_points: bool) -> Choice<[f64; 2]> {
    if let Some(weight) = config.distortion {
        return Choice::said([weight; 2], "distortion");
    }
    if photos < FEW_PHOTOS && has_points {
        let reason = format!(
            "{photos} photos to train on are fewer than {FEW_PHOTOS}, and sparse points show where matter is: the same from the start, before one photo alone explains it"
        );
        return Choice::new(DISTORTION_OF_FEW, reason);
    }
    let why = if photos < FEW_PHOTOS {
        "no sparse points show where matter is".to_owned()
    } else {
        format!("{photos} photos to train on, {FEW_PHOTOS} or more, find where matter is")
    };
    let reason = format!("{why}: it grows from 0 with the square of the share of the training that is done");
    Choice::new(DISTORTION_OF_MANY, reason)
}

/// Returns the steps after which sparse points and distances of pixels no longer pull.
///
/// They show early where matter is. Until the end they would blur what many photos show. Few photos need them
/// longer: `benches/field.md`.
pub(super) fn depth_steps(config: &Config, views: &[View], points: usize) -> Choice<u32> {
    if let Some(steps) = config.depth_steps {
        return Choice::said(steps, "depth_steps");
    }
    let photos = views.len();
    let all = || views.iter().flat_map(|view| &view.distances);
    let distances = all().filter(|one| one.distance.is_finite()).count();
    let sky = all().count() - distances;
    let counted = |count: usize, what: &str| (count > 0).then(|| format!("{} {what}", grouped(count as u64)));
    let what = [
        (points > 0).then(|| "sparse points".to_owned()),
        counted(distances, "distances from pairs of them"),
        counted(sky, "pixels of sky"),
    ];
    let mut what = what.into_iter().flatten().collect::<Vec<_>>().join(" and ");
    if config.depth_source == DepthSource::Pairs && distances == 0 {
        what += " (no pair of them shows distances)";
    }
    let most = grouped(LONGEST_PULL);
    let (steps, reason) = match config.steps {
        _ if points == 0 && distances == 0 && sky == 0 => {
            (LONGEST_PULL, "there are no sparse points".to_owned())
        }
        _ if photos < FEW_PHOTOS => (
            LONGEST_PULL,
            format!("{photos} photos to train on, fewer than {FEW_PHOTOS}, need {what} for {most} steps"),
        ),
        None => (
            LONGEST_PULL,
            format!("{most}: the length of the training is not known"),
        ),
        Some(steps) => (
            (steps / 2).clamp(1, LONGEST_PULL.into()) as u32,
            format!(
                "half of {} steps, {most} at most: later {what} would blur what {photos} photos show",
                grouped(steps)
            ),
        ),
    };
    Choice::new(steps, reason)
}

/// Returns the pull of the tables to zero at the start.
///
/// Fields of few photos from far apart show specks where one of them looks: a pull smooths these. It keeps details small, too, hence it
/// fades, and photos that are more, or overlap, have none: `benches/field.md`.
pub(super) fn table_decay(config: &Config, photos: usize, points: usize) -> Choice<f64> {
    if let Some(pull) = config.table_decay {
        return Choice::said(pull, "table_decay");
    }
    let why = match (photos <= FEWEST_PHOTOS, points < FEW_POINTS_A_PHOTO * photos) {
        (true, true) => {
            let reason = format!(
                "{photos} photos to train on, {FEWEST_PHOTOS} or fewer, and {points} sparse points, fewer than {FEW_POINTS_A_PHOTO} a photo. Surfaces without points should stay smooth. The pull falls to 0 with the square of the remaining share of the training"
            );
            return Choice::new(TABLE_DECAY_OF_FEWEST, reason);
        }
        (true, false) => format!(
            "{points} sparse points of {photos} photos to train on, {FEW_POINTS_A_PHOTO} a photo or more, show where matter is"
        ),
        (false, _) => format!("{photos} photos to train on, more than {FEWEST_PHOTOS}"),
    };
    Choice::new(0.0, format!("{why}: it would keep details small"))
}
