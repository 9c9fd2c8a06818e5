use marf_scene::{
    Image, Srgb,
    picture::{
        ColorScale, DEPTH_DECADES, DEPTH_SPREAD_DECADES, Palette, draw_map, draw_titled, round_upper_limit,
        side_by_side,
    },
};
use marf_schema::{
    bootstrap::{Calibration, HeldOut, Shown},
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
/// Widest interval of gray that can be told from none.
const MOST_LEVELS: f64 = 127.5;

/// Colour scales of all maps, one for each quantity, so that viewpoints can be compared, and what makes intervals.
#[derive(Debug)]
pub(crate) struct Scales {
    std: ColorScale,
    unseen: ColorScale,
    residual: ColorScale,
    total: ColorScale,
    photos: ColorScale,
    depth: ColorScale,
    depth_std: ColorScale,
    error: ColorScale,
    interval: Option<(Calibration, ColorScale)>,
    depth_interval: Option<(Calibration, ColorScale)>,
    metres_per_unit: Option<f64>,
}

impl Scales {
    /// Returns scales that reach the largest values of all views.
    pub fn of<'a>(
        tops: impl Iterator<Item = &'a Tops> + Clone,
        held_out: Option<&HeldOut>,
        metres_per_unit: Option<f64>,
    ) -> Self {
        let scale =
            |title: &str, unit: &str, high: f64| ColorScale::linear(title, unit, high, Palette::Inferno);
        let top = |of: fn(&Tops) -> f64| tops.clone().map(of).fold(0.0, f64::max);
        let length_unit = if metres_per_unit.is_some() {
            "m"
        } else {
            "scene units"
        };
        let length = |of: fn(&Tops) -> f64| rounded(top(of) * metres_per_unit.unwrap_or(1.0));
        let of_gray = held_out
            .and_then(|held_out| held_out.calibration.clone())
            .map(|gray| {
                let half = gray.factor90 * widened(top(|tops| tops.local_spread) as f32, gray.floor) * LEVELS;
                (
                    gray,
                    scale("90 % interval: +-", "gray levels", rounded(half.min(MOST_LEVELS))),
                )
            });
        let of_depth = held_out
            .and_then(|held_out| held_out.depth_calibration.clone())
            .map(|depth| {
                let high = length(|tops| tops.depth_std);
                let scale = scale("90 % interval of depth: +-", length_unit, high);
                (depth, scale.over_decades(DEPTH_SPREAD_DECADES))
            });
        let viridis = |scale: ColorScale| ColorScale {
            palette: Palette::Viridis,
            ..scale
        };
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
            photos: viridis(scale("photos that saw it", "photos", top(|tops| tops.photos))),
            depth: viridis(scale("mean depth", length_unit, length(|tops| tops.depth)))
                .over_decades(DEPTH_DECADES),
            depth_std: scale("std of depth, B-1", length_unit, length(|tops| tops.depth_std))
                .over_decades(DEPTH_SPREAD_DECADES),
            error: scale("error of the mean", "sRGB, white = 1", top(|tops| tops.error)),
            interval: of_gray,
            depth_interval: of_depth,
            metres_per_unit,
        }
    }

    /// Returns lengths in metres where the scene knows them, -1 where there is none.
    fn in_metres(&self, lengths: &[f32]) -> Vec<f32> {
        let metres = self.metres_per_unit.unwrap_or(1.0) as f32;
        let convert = |length: &f32| if *length < 0.0 { -1.0 } else { length * metres };
        lengths.iter().map(convert).collect()
    }
}

/// Returns a number rounded up to 1, 2 or 5 times a power of ten.
fn rounded(high: f64) -> f64 {
    round_upper_limit(&[high as f32], 1.0)
}

/// Returns half the width of the 90 % interval of gray, levels of 255; -1 where no photo saw what the pixel shows.
fn gray_interval(maps: &Maps, calibration: &Calibration) -> Vec<f32> {
    let spreads = maps.local_spread();
    let half = |(pixel, spread): (usize, &f32)| {
        let half = calibration.factor90 * widened(*spread, calibration.floor) * LEVELS;
        if maps.is_seen(pixel) { half as f32 } else { -1.0 }
    };
    spreads.iter().enumerate().map(half).collect()
}

/// Returns half the width of the 90 % interval of the depth, world units; -1 where there is no depth or no photo saw it.
fn depth_interval(maps: &Maps, calibration: &Calibration) -> Vec<f32> {
    let local = locally(&maps.depth_std, maps.width);
    let half = |(pixel, spread): (usize, &f32)| {
        let depth = maps.depth[pixel];
        if depth <= 0.0 || !maps.is_seen(pixel) {
            return -1.0;
        }
        let share = calibration.factor90 * widened(spread / depth, calibration.floor);
        (share * f64::from(depth)) as f32
    };
    local.iter().enumerate().map(half).collect()
}

/// Writes every map of a viewpoint as a picture with its scale, and the raw values as arrays; lengths in metres where the scene knows
/// them.
pub(crate) fn put_view(
    ctx: &Ctx<'_>,
    name: &str,
    maps: &Maps,
    truth: Option<&Truth<'_>>,
    scales: &Scales,
    outputs: &mut Outputs,
) -> Result<(), StageError> {
    let lengths = |lengths: &[f32]| scales.in_metres(lengths);
    let (depth, depth_std) = (lengths(&maps.depth), lengths(&maps.depth_std));
    let mut drawn: Vec<(&str, Vec<f32>, &ColorScale)> = vec![
        ("std", maps.std.clone(), &scales.std),
        ("unseen", maps.unseen.clone(), &scales.unseen),
        ("residual", maps.residual.clone(), &scales.residual),
        ("total", maps.total.clone(), &scales.total),
        ("coverage", maps.photos.clone(), &scales.photos),
        ("depth-std", depth_std.clone(), &scales.depth_std),
    ];
    if let Some((calibration, scale)) = &scales.interval {
        drawn.push(("interval", gray_interval(maps, calibration), scale));
    }
    if let Some((calibration, scale)) = &scales.depth_interval {
        drawn.push((
            "depth-interval",
            lengths(&depth_interval(maps, calibration)),
            scale,
        ));
    }
    if let Some(truth) = truth {
        drawn.push(("error", errors(maps, truth.photo, truth.hidden), &scales.error));
    }
    put_png(
        ctx,
        outputs,
        format!("{MAPS}{name}-mean.png"),
        &mean_picture(maps),
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

/// Returns a picture of the fly-through: mean colour, spread and mean depth side by side, each as wide as the maps.
pub(crate) fn flythrough_picture(maps: &Maps, scales: &Scales, shown: Shown) -> Image<Srgb> {
    let draw = |values: &[f32], scale: &ColorScale| draw_map(values, maps.width, maps.height, scale);
    let spread = match shown {
        Shown::Std => draw(&maps.std, &scales.std),
        Shown::Total => draw(&maps.total, &scales.total),
    };
    let depth = draw(&scales.in_metres(&maps.depth), &scales.depth);
    side_by_side(&[&draw_titled(&mean_picture(maps), "mean colour"), &spread, &depth])
}

/// Returns the size of [`flythrough_picture`] for maps of a size, pixels; the least, where texts are wider than maps.
pub(crate) fn flythrough_size(width: u32, height: u32) -> (u32, u32) {
    let blank = Image::from_fn(width, height, |_, _| [0; 3]);
    let panel = draw_titled(&blank, "");
    (3 * panel.width, panel.height)
}

/// Returns the mean colour, rounded to 8 bits.
pub(crate) fn mean_picture(maps: &Maps) -> Image<Srgb> {
    let round = |value: f32| (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    Image {
        width: maps.width,
        height: maps.height,
        pixels: maps.mean.iter().map(|rgb| rgb.map(round)).collect(),
    }
}
