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
    reach::Reach,
    study::{Truth, errors},
};
use crate::io::put_png;

/// Gray levels of a picture.
const LEVELS: f64 = 255.0;
/// Unit of what is a difference of gray.
const GRAY: &str = "gray levels";
/// Least end of a scale of gray: a photo has no finer step.
const LEAST_LEVELS: f64 = 1.0;
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

/// A map with its picture. The array has sRGB as in the renders, and the picture gray levels.
struct DrawnMap<'a> {
    kind: &'a str,
    /// Values of the array. `None` if another one has them.
    array: Option<Vec<f32>>,
    /// Values of the picture.
    shown: Vec<f32>,
    scale: &'a ColorScale,
}

impl<'a> DrawnMap<'a> {
    /// Returns a map whose picture shows the values of its array.
    fn plain(kind: &'a str, values: Vec<f32>, scale: &'a ColorScale) -> Self {
        Self {
            kind,
            array: Some(values.clone()),
            shown: values,
            scale,
        }
    }

    /// Returns a map of gray, white = 1, whose picture shows gray levels.
    fn gray(kind: &'a str, values: Vec<f32>, scale: &'a ColorScale) -> Self {
        let shown = values.iter().map(|value| value * LEVELS as f32).collect();
        Self {
            shown,
            ..Self::plain(kind, values, scale)
        }
    }
}

impl Scales {
    /// Returns scales for the largest reach of all views of fields that were trained on so many photos.
    pub fn new(
        reach: &Reach,
        held_out: Option<&HeldOut>,
        metres_per_unit: Option<f64>,
        photos: usize,
    ) -> Self {
        let scale =
            |title: &str, unit: &str, high: f64| ColorScale::linear(title, unit, high, Palette::Inferno);
        let gray = |title: &str, high: f64| scale(title, GRAY, rounded((high * LEVELS).max(LEAST_LEVELS)));
        let length = |title: &str, high: f64| {
            let unit = if metres_per_unit.is_some() { "m" } else { "units" };
            scale(title, unit, rounded(high * metres_per_unit.unwrap_or(1.0)))
                .over_decades(DEPTH_SPREAD_DECADES)
        };
        let calibration = held_out.and_then(|held_out| held_out.calibration.clone());
        let interval = calibration.map(|calibration| {
            let half = calibration.factor90 * widened(reach.local_spread as f32, calibration.floor);
            let scale = gray("90 % interval, +-", half.min(MOST_LEVELS / LEVELS));
            (calibration, scale)
        });
        let calibration = held_out.and_then(|held_out| held_out.depth_calibration.clone());
        let depth_interval = calibration.map(|calibration| {
            // The floor is a share of the depth.
            let spread = widened(reach.depth_std as f32, calibration.floor * reach.depth);
            let high = calibration.factor90 * spread;
            let scale = length("depth, 90 % interval, +-", high);
            (calibration, scale)
        });
        Self {
            std: gray("standard deviation", reach.std),
            unseen: scale("what no photo saw", "1 = nothing seen", 1.0),
            residual: gray("error in training photos", reach.residual),
            total: gray("total deviation", reach.total),
            photos: ColorScale::linear(
                "photos that saw it",
                "photos",
                rounded(reach.photos.max(1.0)).min(photos.max(1) as f64),
                Palette::Viridis,
            ),
            depth_std: length("depth, std deviation", reach.depth_std),
            error: gray("error of the mean", reach.error),
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
        let unshared = |kind, shown, scale| DrawnMap {
            array: None,
            ..DrawnMap::plain(kind, shown, scale)
        };
        let mut drawn = vec![
            DrawnMap::gray("std", maps.std.clone(), &self.std),
            unshared("unseen", maps.unseen.clone(), &self.unseen),
            DrawnMap {
                shown: known_residual(maps),
                ..DrawnMap::plain("residual", maps.residual.clone(), &self.residual)
            },
            DrawnMap::gray("total", maps.total.clone(), &self.total),
            unshared("coverage", maps.photos.clone(), &self.photos),
            DrawnMap::plain("depth-std", depth_std, &self.depth_std),
        ];
        if let Some((calibration, scale)) = &self.interval {
            drawn.push(DrawnMap::plain(
                "interval",
                gray_interval(maps, calibration),
                scale,
            ));
        }
        if let Some((calibration, scale)) = &self.depth_interval {
            let values = lengths(&depth_interval(maps, calibration));
            drawn.push(DrawnMap::plain("depth-interval", values, scale));
        }
        if let Some(truth) = truth {
            let values = errors(maps, truth.photo, truth.hidden);
            drawn.push(DrawnMap::gray("error", values, &self.error));
        }
        put_png(
            ctx,
            outputs,
            format!("{MAPS}{name}-mean.png"),
            &maps.mean_picture(),
        )?;
        for map in &drawn {
            let picture = draw_map(&map.shown, maps.width, maps.height, map.scale);
            put_png(ctx, outputs, format!("{MAPS}{name}-{}.png", map.kind), &picture)?;
        }
        let mut put_array = |kind: &str, channels: u32, values: &[f32]| {
            let shape = [maps.height, maps.width, channels];
            let shape = &shape[..if channels == 1 { 2 } else { 3 }];
            let array = encode_npy(shape, values.iter().copied());
            outputs.put_bytes(ctx, format!("{MAPS}{name}-{kind}.npy"), &array)
        };
        for map in &drawn {
            if let Some(array) = &map.array {
                put_array(map.kind, 1, array)?;
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

/// Returns the residual in gray levels, or -1 where no photo shows what the pixel shows, so that there is none.
fn known_residual(maps: &Maps) -> Vec<f32> {
    let pixels = maps.residual.iter().zip(&maps.photos);
    let known = pixels.map(|(residual, photos)| {
        if *photos > 0.0 {
            residual * LEVELS as f32
        } else {
            -1.0
        }
    });
    known.collect()
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

#[cfg(test)]
mod tests {
    use super::super::maps::tests::{example, maps_of};
    use super::*;

    /// 0.0433 x 255 = 11.04, 0.04899 x 255 = 12.49, 0.03 x 255 = 7.65, 1.29 m x 0.5 = 0.645.
    #[test]
    fn scales_end_at_round_gray_levels_and_metres_above_what_most_seen_pixels_have() {
        let reach = Reach::new(&maps_of(&example()), &[0.01, 0.02, 0.03, 0.9]);
        let scales = Scales::new(&reach, None, Some(0.5), 4);
        let ends = [
            (&scales.total, 20.0),
            (&scales.std, 20.0),
            (&scales.error, 10.0),
            (&scales.residual, 1.0),
            (&scales.photos, 4.0),
            (&scales.unseen, 1.0),
        ];
        for (scale, end) in ends {
            assert_eq!((scale.low, scale.high), (0.0, end), "{}", scale.title);
        }
        assert_eq!((scales.depth_std.low, scales.depth_std.high), (0.001, 1.0));
        assert_eq!(scales.depth_std.unit, "m, log");
    }

    /// Total deviations of 3.6, 10.9, 11.0 and 216.8 levels on a scale to 20: 0.18, 0.54, 0.55, and the top.
    #[test]
    fn a_total_deviation_has_colours_and_what_is_above_has_the_top_one() {
        let maps = maps_of(&example());
        let scales = Scales::new(&Reach::new(&maps, &[]), None, None, 4);
        let drawn = DrawnMap::gray("total", maps.total.clone(), &scales.total);
        let colors = [0.180_312, 0.544_680, 0.552_087, 1.0].map(|share| Palette::Inferno.color(share));
        let found: Vec<[u8; 3]> = drawn
            .shown
            .iter()
            .map(|value| scales.total.color(*value))
            .collect();
        assert_eq!(found, colors);
        assert_eq!(drawn.array, Some(maps.total.clone()), "arrays keep white = 1");
        for scale in [&scales.depth_std, &scales.total] {
            assert!(scale.title.len() <= 24, "{}", scale.title);
        }
    }

    #[test]
    fn where_no_photo_shows_it_the_residual_is_gray() {
        let mut maps = maps_of(&example());
        maps.residual = vec![0.1, 0.0, 0.0, 0.0];
        maps.photos[1] = 0.0;
        assert_eq!(known_residual(&maps), [25.5, -1.0, 0.0, 0.0]);
    }
}
