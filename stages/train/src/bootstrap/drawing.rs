use marf_scene::picture::{ColorScale, DEPTH_SPREAD_DECADES, Palette, draw_map, round_upper_limit};
use marf_schema::{
    bootstrap::{Calibration, HeldOut},
    output::MAPS,
};
use marf_stage::{Ctx, Outputs, StageError, TypedOutputs};

use super::{
    intervals::{locally, widened},
    maps::Maps,
    npy::encode_npy,
    study::{Tops, Truth, errors},
};
use crate::io::put_png;

/// Gray levels of a picture.
const LEVELS: f64 = 255.0;
/// Widest interval of gray that a map can show.
const MOST_LEVELS: f64 = 127.5;

/// Colour scales of all maps, one for each quantity, so that viewpoints can be compared, and what makes intervals.
#[derive(Debug)]
pub(crate) struct Scales {
    std: ColorScale,
    unseen: ColorScale,
    residual: ColorScale,
    total: ColorScale,
    photos: ColorScale,
    depth_std: ColorScale,
    error: ColorScale,
    interval: Option<(Calibration, ColorScale)>,
    depth_interval: Option<(Calibration, ColorScale)>,
    metres_per_unit: Option<f64>,
}

impl Scales {
    /// Returns scales that reach the largest values of all views.
    pub fn new<'a>(
        tops: impl Iterator<Item = &'a Tops> + Clone,
        held_out: Option<&HeldOut>,
        metres_per_unit: Option<f64>,
    ) -> Self {
        let scale =
            |title: &str, unit: &str, high: f64| ColorScale::linear(title, unit, high, Palette::Inferno);
        let top = |value: fn(&Tops) -> f64| tops.clone().map(value).fold(0.0, f64::max);
        let length_unit = if metres_per_unit.is_some() {
            "m"
        } else {
            "scene units"
        };
        let length = |value: fn(&Tops) -> f64| rounded(top(value) * metres_per_unit.unwrap_or(1.0));
        let interval = held_out
            .and_then(|held_out| held_out.calibration.clone())
            .map(|gray| {
                let half = gray.factor90 * widened(top(|tops| tops.local_spread) as f32, gray.floor) * LEVELS;
                (
                    gray,
                    scale("90 % interval: +-", "gray levels", rounded(half.min(MOST_LEVELS))),
                )
            });
        let depth_interval = held_out
            .and_then(|held_out| held_out.depth_calibration.clone())
            .map(|depth| {
                let high = length(|tops| tops.depth_std);
                let scale = scale("90 % interval of depth: +-", length_unit, high);
                (depth, scale.over_decades(DEPTH_SPREAD_DECADES))
            });
        Self {
            std: scale("std of gray, B-1", "sRGB, white = 1", top(|tops| tops.std)),
            unseen: scale("what no photo saw", "1 = nothing seen", 1.0),
            residual: scale(
                "error where photos show it",
                "sRGB, white = 1",
                top(|tops| tops.residual),
            ),
            // Unseen pixels have more than any error of a colour can be.
            total: scale("total sd", "sRGB, white = 1", top(|tops| tops.total).min(1.0)),
            photos: ColorScale::linear(
                "photos that saw it",
                "photos",
                top(|tops| tops.photos),
                Palette::Viridis,
            ),
            depth_std: scale("std of depth, B-1", length_unit, length(|tops| tops.depth_std))
                .over_decades(DEPTH_SPREAD_DECADES),
            error: scale("error of the mean", "sRGB, white = 1", top(|tops| tops.error)),
            interval,
            depth_interval,
            metres_per_unit,
        }
    }

    /// Returns lengths in metres if the scene knows its scale. -1 marks pixels without a length.
    fn in_metres(&self, lengths: &[f32]) -> Vec<f32> {
        let metres = self.metres_per_unit.unwrap_or(1.0) as f32;
        let convert = |length: &f32| if *length < 0.0 { -1.0 } else { length * metres };
        lengths.iter().map(convert).collect()
    }

    /// Writes every map of a viewpoint as a picture with its scale, and the raw values as arrays. Lengths are in metres if the scene knows
    /// its scale.
    pub fn put_view(
        &self,
        ctx: &Ctx<'_>,
        name: &str,
        maps: &Maps,
        truth: Option<&Truth<'_>>,
        outputs: &mut Outputs,
    ) -> Result<(), StageError> {
        let lengths = |lengths: &[f32]| self.in_metres(lengths);
        let (depth, depth_std) = (lengths(&maps.depth), lengths(&maps.depth_std));
        let mut drawn: Vec<(&str, Vec<f32>, &ColorScale)> = vec![
            ("std", maps.std.clone(), &self.std),
            ("unseen", maps.unseen.clone(), &self.unseen),
            ("residual", maps.residual.clone(), &self.residual),
            ("total", maps.total.clone(), &self.total),
            ("coverage", maps.photos.clone(), &self.photos),
            ("depth-std", depth_std.clone(), &self.depth_std),
        ];
        if let Some((calibration, scale)) = &self.interval {
            drawn.push(("interval", gray_interval(maps, calibration), scale));
        }
        if let Some((calibration, scale)) = &self.depth_interval {
            drawn.push((
                "depth-interval",
                lengths(&depth_interval(maps, calibration)),
                scale,
            ));
        }
        if let Some(truth) = truth {
            drawn.push(("error", errors(maps, truth.photo, truth.hidden), &self.error));
        }
        put_png(
            ctx,
            outputs,
            format!("{MAPS}{name}-mean.png"),
            &maps.mean_picture(),
        )?;
        for (kind, values, scale) in &drawn {
            let picture = draw_map(values, maps.width, maps.height, scale);
            put_png(ctx, outputs, format!("{MAPS}{name}-{kind}.png"), &picture)?;
        }
        let mut put_array = |kind: &str, channels: u32, values: &[f32]| {
            let shape = [maps.height, maps.width, channels];
            let shape = &shape[..if channels == 1 { 2 } else { 3 }];
            let array = encode_npy(shape, values.iter().copied());
            outputs.put_bytes(ctx, format!("{MAPS}{name}-{kind}.npy"), &array)
        };
        for (kind, values, _) in &drawn {
            if !matches!(*kind, "unseen" | "coverage") {
                put_array(kind, 1, values)?;
            }
        }
        put_array("depth", 1, &depth)?;
        put_array("rgb-std", 3, maps.rgb_std.as_flattened())?;
        let distance = lengths(&maps.photo_distance);
        let seen = maps.photos.iter().zip(&distance).zip(&maps.incidence_deg);
        let seen: Vec<[f32; 3]> = seen
            .map(|((photos, distance), angle)| [*photos, *distance, *angle])
            .collect();
        put_array("coverage", 3, seen.as_flattened())
    }
}

/// Returns a number rounded up to 1, 2 or 5 times a power of ten.
fn rounded(high: f64) -> f64 {
    round_upper_limit(&[high as f32], 1.0)
}

/// Returns half the width of the 90 % interval of gray, levels of 255, or -1 where no photo saw what the pixel shows.
fn gray_interval(maps: &Maps, calibration: &Calibration) -> Vec<f32> {
    let spreads = maps.local_spread();
    let halves = spreads.iter().enumerate().map(|(pixel, spread)| {
        let half = calibration.factor90 * widened(*spread, calibration.floor) * LEVELS;
        if maps.is_seen(pixel) { half as f32 } else { -1.0 }
    });
    halves.collect()
}

/// Returns half the width of the 90 % interval of the depth, world units, or -1 where there is no depth or no photo saw it.
fn depth_interval(maps: &Maps, calibration: &Calibration) -> Vec<f32> {
    let local = locally(&maps.depth_std, maps.width);
    let halves = local.iter().enumerate().map(|(pixel, spread)| {
        let depth = maps.depth[pixel];
        if depth <= 0.0 || !maps.is_seen(pixel) {
            return -1.0;
        }
        let share = calibration.factor90 * widened(spread / depth, calibration.floor);
        (share * f64::from(depth)) as f32
    });
    halves.collect()
}
