//! How large a field need be: near, far, levels and table, each beside the number that decided it.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::config::MOST_HALVINGS;
use crate::cpu::march::{Steps, contract};
use crate::cpu::math::root;
use crate::distances::{Depths, SHARP};
use crate::frame::{FAR, Frame, MOST_FINEST, percentile};
use crate::{Config, FieldError, View};

/// A number and what decided it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Chosen<T> {
    /// The number.
    pub value: T,
    /// A sentence with the number that decided it.
    pub reason: String,
}

/// What the scene, or a key of the configuration, decides about the size of a field; the box is a [`Frame`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sizes {
    /// Distance of the first sample from the camera, half sides of the box.
    pub near: Chosen<f64>,
    /// Distance of the last sample from the camera, half sides.
    pub far: Chosen<f64>,
    /// Cells a side of the finest level, over the whole contracted box.
    pub finest: Chosen<u32>,
    /// Levels of the grid.
    pub levels: Chosen<u32>,
    /// Cells of the finest level that the surface passes through.
    pub surface_cells: Chosen<u64>,
    /// Binary logarithm of the most entries of a level.
    pub log2_table: Chosen<u32>,
    /// Times that the steps along rays are halved in training, at most.
    pub halvings: Chosen<u32>,
    /// Weight of the distortion loss at the start and at the end of the training; between it goes with the square of the share
    /// that is done.
    #[serde(default = "distortion_before")]
    pub distortion: Chosen<[f64; 2]>,
    /// Pull of the tables to zero at the start, see [`Config::table_decay`].
    #[serde(default = "table_decay_before")]
    pub table_decay: Chosen<f64>,
}

/// Distance of the first sample where nothing is known, half sides.
const NEAR: f64 = 0.1;
/// Surface without sparse points on it may come this much nearer than they do.
const NEARER: f64 = 0.5;
/// ... and go on this much farther: a ridge without texture has no points.
const FARTHER: f64 = 8.0;
/// A level may have this many times the cells a side of the one below; the trilinear corners fill the octave.
const MOST_GROWTH: f64 = 2.0;
/// Sparse points a cell, at least, where cells are counted: fewer, and cells of the surface are missed.
const POINTS_A_CELL: usize = 4;
/// Fewer cells are no surface: all points lie in one place.
const ENOUGH_CELLS: usize = 8;
/// Finest cells an entry may be shared by: the other levels tell them apart (instant-ngp, section 3).
const CELLS_AN_ENTRY: u64 = 4;
/// The last steps are at most so many pixels long at their distance.
const PIXELS_A_STEP: f64 = 1.0;
/// Fewer photos than this are few: matter is to gather on surfaces before one of them alone explains it.
const FEW_PHOTOS: usize = 24;
/// Weights of the distortion loss at the start and at the end, of few photos and of many. `benches/field.md`.
const DISTORTION_OF_FEW: [f64; 2] = [0.03; 2];
const DISTORTION_OF_MANY: [f64; 2] = [0.0, 0.1];
/// So many photos or fewer have their tables pulled to zero, so strongly at the start, where they overlap so little that a photo has
/// fewer sparse points than this. `benches/field.md`.
const FEWEST_PHOTOS: usize = 9;
const FEW_POINTS_A_PHOTO: usize = 50;
const TABLE_DECAY_OF_FEWEST: f64 = 1e-5;
/// Smallest and largest table that is derived.
const TABLES: [u32; 2] = [12, 22];

/// Derives all sizes; a key that is set wins over the scene.
///
/// `points`: sparse surface points, world units; fewer than 32, or points that no camera sees, count as none.
/// `frame`: the box of both. Every number is finite, `near` is below `far`, whatever the points are.
pub fn derive(views: &[View], points: &[[f64; 3]], config: &Config, frame: &Frame) -> Sizes {
    let depths = Depths::seen(views, points, frame);
    let finest = finest(config, &depths, frame, views);
    let surface = if depths.is_ok() { points } else { &[] };
    let surface_cells = surface_cells(views, surface, frame, finest.value);
    Sizes {
        near: near(config, &depths),
        far: far(config, &depths),
        levels: levels(config, finest.value),
        log2_table: log2_table(config, surface_cells.value),
        halvings: halvings(config, views),
        distortion: distortion(config, views.len(), depths.is_ok()),
        table_decay: table_decay(config, views.len(), points.len()),
        finest,
        surface_cells,
    }
}

impl Sizes {
    /// Returns the largest sizes that any scene asks for under these keys.
    pub(crate) fn most(config: &Config) -> Self {
        let any = "any scene";
        let finest = config.finest_resolution.unwrap_or(MOST_FINEST);
        let finest = scaled(Chosen::new(finest, any), config).value;
        Self {
            near: Chosen::new(NEAR, any),
            far: Chosen::new(FAR, any),
            finest: Chosen::new(finest.max(config.base_resolution), any),
            levels: levels(config, finest),
            surface_cells: Chosen::new(u64::MAX, any),
            log2_table: log2_table(config, u64::MAX),
            halvings: Chosen::new(0, any),
            distortion: Chosen::new([0.0; 2], any),
            table_decay: Chosen::new(0.0, any),
        }
    }

    /// Returns where rays are looked at after so many halvings of the steps.
    ///
    /// The shortest step is `min_step`, or that of `cone` at the nearest matter if that is less: close-ups get steps of as
    /// many pixels as all else.
    pub(crate) fn steps(&self, config: &Config, halvings: u32) -> Steps {
        let share = 0.5_f64.powi(halvings.min(MOST_HALVINGS) as i32);
        let nearest = self.near.value / NEARER;
        let shortest = config.min_step.min(config.cone * nearest) * share;
        let cone = config.cone * share;
        Steps::new(self.near.value, self.far.value, shortest, cone)
    }

    /// Checks that these sizes, which another program may have written, can be used.
    pub(crate) fn check(&self, config: &Config) -> Result<(), FieldError> {
        let finest = self.finest.value;
        if finest < config.base_resolution || finest > 1 << 20 {
            let value = f64::from(finest);
            let range = "base_resolution to 1048576";
            return Err(FieldError::Config {
                key: "finest",
                value,
                range,
            });
        }
        let (near, far) = (self.near.value, self.far.value);
        if !(near > 0.0 && far > near && far.is_finite()) {
            let range = "above 0 and below `far`";
            return Err(FieldError::Config {
                key: "near",
                value: near,
                range,
            });
        }
        let [first, last] = self.distortion.value;
        for (key, value) in [
            ("distortion", first),
            ("distortion", last),
            ("table_decay", self.table_decay.value),
        ] {
            if !(0.0..=1.0).contains(&value) {
                let range = "0 to 1";
                return Err(FieldError::Config { key, value, range });
            }
        }
        let keys = Config {
            levels: Some(self.levels.value),
            log2_table: Some(self.log2_table.value),
            halvings: Some(self.halvings.value),
            ..config.clone()
        };
        keys.check()
    }
}

impl<T> Chosen<T> {
    fn new(value: T, reason: impl Into<String>) -> Self {
        let reason = reason.into();
        Self { value, reason }
    }

    fn said(value: T, key: &str) -> Self {
        Self::new(value, format!("`{key}` says so"))
    }
}

fn near(config: &Config, depths: &Result<Depths, String>) -> Chosen<f64> {
    if let Some(near) = config.near {
        return Chosen::said(near, "near");
    }
    let near = match depths {
        Err(why) => Chosen::new(NEAR, format!("{why}: {NEAR} half sides of the box")),
        Ok(Depths { nearest, .. }) => Chosen::new(
            (NEARER * nearest).clamp(1e-4, FAR),
            format!(
                "99 % of the sparse points that cameras see are farther than {nearest:.4} half sides; half of that"
            ),
        ),
    };
    match config.far {
        Some(far) if near.value >= far => Chosen::new(0.5 * far, format!("half of `far`, which is {far}")),
        _ => near,
    }
}

fn far(config: &Config, depths: &Result<Depths, String>) -> Chosen<f64> {
    if let Some(far) = config.far {
        return Chosen::said(far, "far");
    }
    let far = match depths {
        Err(why) => Chosen::new(
            FAR,
            format!("{why}: {FAR} half sides, beyond which no cell of the finest level is resolved"),
        ),
        Ok(Depths { farthest, most, .. }) => Chosen::new(
            (FARTHER * farthest).min(*most),
            format!(
                "99 % of the sparse points that cameras see are nearer than {farthest:.4} half sides; {FARTHER} times that, at most {most:.0}"
            ),
        ),
    };
    let near = near(config, depths).value;
    if far.value > near {
        return far;
    }
    Chosen::new(2.0 * near, format!("twice `near`, which is {near}"))
}

/// Returns the cells a side of the finest level, with the factor of a search.
fn finest(config: &Config, depths: &Result<Depths, String>, frame: &Frame, views: &[View]) -> Chosen<u32> {
    scaled(finest_asked(config, depths, frame, views), config)
}

fn scaled(asked: Chosen<u32>, config: &Config) -> Chosen<u32> {
    let factor = config.finest_factor;
    if factor == 1.0 {
        return asked;
    }
    let least = f64::from(config.base_resolution);
    let most = f64::from(asked.value.max(MOST_FINEST).max(config.base_resolution));
    let cells = (factor * f64::from(asked.value)).round().clamp(least, most);
    let reason = format!("`finest_factor` is {factor}; {}", asked.reason);
    Chosen::new(cells as u32, reason)
}

/// Returns the cells a side that are as wide as a pixel: of the contracted box, which is 4 half sides wide.
fn finest_asked(
    config: &Config,
    depths: &Result<Depths, String>,
    frame: &Frame,
    views: &[View],
) -> Chosen<u32> {
    if let Some(finest) = config.finest_resolution {
        return Chosen::said(finest, "finest_resolution");
    }
    let (footprint, reason) = match depths {
        Ok(Depths {
            footprints: [near, middle],
            ..
        }) => (
            *near,
            format!(
                "{:.0} % of the sparse points that cameras see have pixels wider than {near:.6} half sides of the contracted box, half of them wider than {middle:.6}",
                100.0 * (1.0 - SHARP)
            ),
        ),
        Err(why) => {
            let mut focals: Vec<f64> = views.iter().map(|view| view.camera.fx_px).collect();
            let focal_px = percentile(&mut focals, 0.5);
            let depth = frame.depth / frame.half_side;
            let reason = format!(
                "{why}: a pixel is {:.6} half sides wide at the distance {depth:.4} (focal length {focal_px:.0} px)",
                depth / focal_px
            );
            (depth / focal_px, reason)
        }
    };
    let cells = (4.0 / footprint).ceil().clamp(16.0, f64::from(MOST_FINEST)) as u32;
    Chosen::new(cells.max(config.base_resolution), reason)
}

/// Returns the fewest levels whose growth is at most 2, of those that fill blocks of 16 features.
fn levels(config: &Config, finest: u32) -> Chosen<u32> {
    if let Some(levels) = config.levels {
        return Chosen::said(levels, "levels");
    }
    let (base, features) = (config.base_resolution, config.features);
    let growth = |levels: u32| root(f64::from(finest) / f64::from(base), levels - 1);
    let step = 16 / features;
    let allowed = (1..=16 / step).map(|count| count * step);
    // A hair above 2 is 2: the root is found by halving.
    let enough = allowed
        .clone()
        .find(|levels| growth(*levels) <= MOST_GROWTH + 1e-6);
    let levels = enough.unwrap_or(16);
    let mut reason = format!(
        "from {base} to {} cells by {:.2} a level",
        grouped(finest.into()),
        growth(levels)
    );
    if levels > step {
        let fewer = levels - step;
        reason += &format!(
            "; {fewer} levels would grow by {:.2}, more than {MOST_GROWTH}",
            growth(fewer)
        );
    }
    Chosen::new(levels, reason)
}

/// Cells of the finest level that hold surface.
///
/// Sparse points are counted by cells as small as they are dense enough for; a surface meets 4 times the cells when
/// their side is halved.
fn surface_cells(views: &[View], points: &[[f64; 3]], frame: &Frame, finest: u32) -> Chosen<u64> {
    let found = counted(points, frame, finest);
    let surface = found.unwrap_or_else(|| {
        let side = u64::from(finest).div_ceil(2);
        let reason =
            format!("no surface of sparse points: the six faces of the inner box, {side} cells a side");
        Chosen::new(6 * side * side, reason)
    });
    let size = |view: &View| u64::from(view.camera.width) * u64::from(view.camera.height);
    let pixels: u64 = views.iter().map(size).sum();
    if surface.value <= pixels {
        return surface;
    }
    Chosen::new(
        pixels,
        format!(
            "one a pixel of the photos, fewer than {} ({})",
            grouped(surface.value),
            surface.reason
        ),
    )
}

fn counted(points: &[[f64; 3]], frame: &Frame, finest: u32) -> Option<Chosen<u64>> {
    let inside = |point: &[f64; 3]| {
        // Far above any scene and below the end of f32.
        let at = frame
            .inward(&Vector3::from(*point))
            .map(|x| x.clamp(-1e30, 1e30) as f32);
        contract(at).0
    };
    let points: Vec<[f32; 3]> = points.iter().map(inside).collect();
    let cells_of = |side: u32| {
        let cell = |at: &[f32; 3]| at.map(|x| ((x * side as f32) as u32).min(side - 1));
        let mut cells: Vec<[u32; 3]> = points.iter().map(cell).collect();
        cells.sort_unstable();
        cells.dedup();
        cells.len()
    };
    let dense = |side: &u32| points.len() >= POINTS_A_CELL * cells_of(*side);
    let sides = (3..=finest.max(8).ilog2()).map(|log2| 1_u32 << log2);
    let side = sides.take_while(dense).last()?;
    let cells = cells_of(side);
    if cells < ENOUGH_CELLS {
        return None;
    }
    let ratio = f64::from(finest) / f64::from(side);
    let value = (cells as f64 * ratio * ratio).round() as u64;
    let reason = format!(
        "{} sparse points lie in {} of {side}^3 cells; the surface through them meets {:.0} times as many of the finest",
        grouped(points.len() as u64),
        grouped(cells as u64),
        ratio * ratio
    );
    Some(Chosen::new(value, reason))
}

/// Returns how often steps must be halved to end at the width of a pixel or less.
fn halvings(config: &Config, views: &[View]) -> Chosen<u32> {
    if let Some(halvings) = config.halvings {
        return Chosen::said(halvings, "halvings");
    }
    let mut focals: Vec<f64> = views.iter().map(|view| view.camera.fx_px).collect();
    let focal_px = percentile(&mut focals, 0.5);
    let pixels = config.cone * focal_px;
    let length = |halvings: u32| pixels * 0.5_f64.powi(halvings as i32);
    let enough = (0..MOST_HALVINGS).find(|halvings| length(*halvings) <= PIXELS_A_STEP);
    let halvings = enough.unwrap_or(MOST_HALVINGS);
    let reason = format!(
        "a step of `cone` is {pixels:.1} pixels long (focal length {focal_px:.0} px); it ends at {:.2}, the first at most {PIXELS_A_STEP} or the {MOST_HALVINGS}th",
        length(halvings)
    );
    Chosen::new(halvings, reason)
}

/// Returns the weights of fields that do not tell theirs: they were trained before it followed the photos.
fn distortion_before() -> Chosen<[f64; 2]> {
    Chosen::new([1e-3; 2], "the same for all scenes")
}

/// Returns the weights of the distortion loss at the start and at the end.
fn distortion(config: &Config, photos: usize, has_points: bool) -> Chosen<[f64; 2]> {
    if let Some(weight) = config.distortion {
        return Chosen::said([weight; 2], "distortion");
    }
    if photos < FEW_PHOTOS && has_points {
        let reason = format!(
            "{photos} photos to train on are fewer than {FEW_PHOTOS}, and sparse points tell where matter is: the same from the start, before one photo alone explains it"
        );
        return Chosen::new(DISTORTION_OF_FEW, reason);
    }
    let why = match photos < FEW_PHOTOS {
        true => "no sparse points tell where matter is".to_owned(),
        false => format!("{photos} photos to train on, {FEW_PHOTOS} or more, find where matter is"),
    };
    let reason = format!("{why}: it grows from 0 with the square of the share of the training that is done");
    Chosen::new(DISTORTION_OF_MANY, reason)
}

/// Returns the pull of fields that do not tell theirs: they were trained before there was one.
fn table_decay_before() -> Chosen<f64> {
    Chosen::new(0.0, "none")
}

/// Returns the pull of the tables to zero at the start.
///
/// Fields of few photos from far apart show specks where one of them looks: a pull smooths these. It keeps details small, too, hence it
/// fades, and photos that are more, or overlap, have none: `benches/field.md`.
fn table_decay(config: &Config, photos: usize, points: usize) -> Chosen<f64> {
    if let Some(pull) = config.table_decay {
        return Chosen::said(pull, "table_decay");
    }
    let why = match (photos <= FEWEST_PHOTOS, points < FEW_POINTS_A_PHOTO * photos) {
        (true, true) => {
            let reason = format!(
                "{photos} photos to train on, {FEWEST_PHOTOS} or fewer, and {points} sparse points, fewer than {FEW_POINTS_A_PHOTO} a photo: what they tell nothing of is to stay smooth; it falls to 0 with the square of the share of the training that is left"
            );
            return Chosen::new(TABLE_DECAY_OF_FEWEST, reason);
        }
        (true, false) => format!(
            "{points} sparse points of {photos} photos to train on, {FEW_POINTS_A_PHOTO} a photo or more, tell where matter is"
        ),
        (false, _) => format!("{photos} photos to train on, more than {FEWEST_PHOTOS}"),
    };
    Chosen::new(0.0, format!("{why}: it would keep details small"))
}

/// Returns the table, with the shift of a search.
fn log2_table(config: &Config, cells: u64) -> Chosen<u32> {
    let asked = log2_table_asked(config, cells);
    let shift = config.log2_table_shift;
    if shift == 0 {
        return asked;
    }
    let log2 = asked.value.saturating_add_signed(shift).clamp(8, 24);
    Chosen::new(log2, format!("`log2_table_shift` is {shift}; {}", asked.reason))
}

/// Returns the table for four cells of the surface an entry, but no more entries than the training has samples to fill.
fn log2_table_asked(config: &Config, cells: u64) -> Chosen<u32> {
    if let Some(log2) = config.log2_table {
        return Chosen::said(log2, "log2_table");
    }
    let [least, most] = TABLES;
    let wanted = cells.div_ceil(CELLS_AN_ENTRY).max(1).next_power_of_two().ilog2();
    let wanted = wanted.clamp(least, most);
    let scene = format!(
        "{} cells of surface, {CELLS_AN_ENTRY} an entry, want 2^{wanted}",
        grouped(cells)
    );
    let Some(steps) = config.steps else {
        return Chosen::new(
            wanted,
            format!("{scene}; how long it will be trained is not known"),
        );
    };
    let samples = steps.saturating_mul(config.batch_samples.into());
    let filled = log2_filled(samples).clamp(least, most);
    let budget = format!(
        "{} steps of {} samples fill 2^{filled}",
        grouped(steps),
        grouped(config.batch_samples.into())
    );
    if filled < wanted {
        return Chosen::new(filled, format!("the budget decides: {budget}; {scene}"));
    }
    Chosen::new(wanted, format!("the scene decides: {scene}; {budget}"))
}

/// Returns the binary logarithm of the table that so many samples fill: 2^15 at 2^23.5 samples, 4 times as large at 8
/// times as many.
///
/// A larger one has learnt less by then, a smaller one cannot hold more: `benches/size.md`.
fn log2_filled(samples: u64) -> u32 {
    let twice = u128::from(samples.max(1)).pow(2).ilog2();
    twice.saturating_sub(2) / 3
}

/// Writes a count in groups of three digits.
pub fn grouped(count: u64) -> String {
    let digits = count.to_string();
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}
