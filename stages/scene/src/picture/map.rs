//! Values drawn as colours, with a scale.

use super::{Palette, draw_text, font::HEIGHT_PX, text_width_px};
use crate::{Image, Srgb, metrics::ln};

/// The colour scale of a map, drawn below it.
#[derive(Debug, Clone, PartialEq)]
pub struct ColorScale {
    /// Title of the map.
    pub title: String,
    /// Unit of the values. Empty for a plain number.
    pub unit: String,
    /// Value of the lowest colour.
    pub low: f64,
    /// Value of the highest colour. Larger values have the same one.
    pub high: f64,
    /// Whether equal steps of colour are equal factors, not equal differences. `low` is above 0 then, and smaller values have its colour.
    pub logarithmic: bool,
    /// The colours.
    pub palette: Palette,
}

impl ColorScale {
    /// Returns a scale from 0 to a value, with equal differences.
    pub fn linear(title: &str, unit: &str, high: f64, palette: Palette) -> Self {
        Self {
            title: title.to_owned(),
            unit: unit.to_owned(),
            low: 0.0,
            high,
            logarithmic: false,
            palette,
        }
    }

    /// Returns the scale with equal factors, over `decades` powers of ten below its highest value.
    #[must_use]
    pub fn over_decades(self, decades: i32) -> Self {
        Self {
            low: self.high / 10_f64.powi(decades),
            logarithmic: true,
            unit: format!("{}, log", self.unit),
            ..self
        }
    }

    /// Returns the colour of a value. Negative ones have none and are gray.
    pub fn color(&self, value: f32) -> [u8; 3] {
        if value < 0.0 {
            return NO_VALUE;
        }
        let share = if self.logarithmic {
            // The larger of no number and the low end is the low end.
            let value = f64::from(value).max(self.low).min(self.high);
            ln(value / self.low) / ln(self.high / self.low)
        } else {
            (f64::from(value) - self.low) / (self.high - self.low).max(f64::MIN_POSITIVE)
        };
        self.palette.color(share as f32)
    }
}

/// Powers of ten that the colours of depths span: near ground takes most of a picture, and the farthest point sets the end.
pub const DEPTH_DECADES: i32 = 2;
/// Those of their spread and of their intervals.
pub const DEPTH_SPREAD_DECADES: i32 = 3;

/// Colour of a pixel without a value.
const NO_VALUE: [u8; 3] = [96, 96, 104];
/// Colour of the background.
const GROUND: [u8; 3] = [24, 24, 28];

/// Draws values as colours, the title above and the colour scale with its two ends below.
///
/// `values`: `[height * width]`, row-major from the top. Negative ones have no value and are gray.
/// The picture is at least as wide as its text, the map is centred in it. At 160 pixels or more that is the width of the map, if the title
/// has at most 24 letters, and unit and ends together at most 22. Pictures next to each other have one size then.
pub fn draw_map(values: &[f32], width: u32, height: u32, scale: &ColorScale) -> Image<Srgb> {
    let Layout { zoom, gap, line } = Layout::new(width);
    let (low, high) = ((scale.low as f32).to_string(), top_label(values, scale));
    // As wide as the longest label: maps on one scale have one size, whatever their values.
    let longest = format!("{low} {} {ABOVE}{}", scale.unit, scale.high);
    let legend = text_width_px(&longest, zoom) + 4 * gap;
    let mut picture = titled(&scale.title, width.max(legend), width, height);
    let full = picture.width;
    let left = (full - width) / 2;
    let map = Rectangle {
        left,
        top: line,
        width,
        height,
    };
    paste(&mut picture, map, |column, row| {
        scale.color(values[(row * width + column) as usize])
    });
    let bar_top = line + height + gap;
    let bar = Rectangle {
        left: gap,
        top: bar_top,
        width: full - 2 * gap,
        height: 3 * gap,
    };
    paste(&mut picture, bar, |column, _| {
        scale.palette.color(column as f32 / bar.width.max(2) as f32)
    });
    let text_top = bar_top + 4 * gap;
    let right = full - gap - text_width_px(&high, zoom);
    // In the middle of the space between the ends.
    let low_end = gap + text_width_px(&low, zoom);
    let middle = (low_end + right).saturating_sub(text_width_px(&scale.unit, zoom)) / 2;
    draw_text(&mut picture, gap, text_top, zoom, &low);
    draw_text(&mut picture, middle, text_top, zoom, &scale.unit);
    draw_text(&mut picture, right, text_top, zoom, &high);
    picture
}

/// Sizes of the parts around a map, pixels.
struct Layout {
    /// Factor of the text.
    zoom: u32,
    gap: u32,
    /// Height of a line of text with its gaps.
    line: u32,
}

impl Layout {
    /// Returns those of a map of a width.
    fn new(width: u32) -> Self {
        let zoom = (width / 160).max(1);
        let gap = 3 * zoom;
        let line = HEIGHT_PX * zoom + 2 * gap;
        Self { zoom, gap, line }
    }
}

/// Returns a dark picture with a title, at least `full` wide, with the space for a map of a size and its colour scale.
fn titled(title: &str, full: u32, width: u32, height: u32) -> Image<Srgb> {
    let Layout { zoom, gap, line } = Layout::new(width);
    let full = full.max(text_width_px(title, zoom) + 2 * gap);
    let mut picture = Image::from_fn(full, height + 2 * line + 4 * gap, |_, _| GROUND);
    draw_text(&mut picture, gap, gap, zoom, title);
    picture
}

/// Draws a picture below a title, where [`draw_map`] draws a map of that size, in a picture of the same height.
pub fn draw_titled(image: &Image<Srgb>, title: &str) -> Image<Srgb> {
    let (width, height) = (image.width, image.height);
    let mut picture = titled(title, width, width, height);
    let below = Rectangle {
        left: (picture.width - width) / 2,
        top: Layout::new(width).line,
        width,
        height,
    };
    paste(&mut picture, below, |column, row| image.at(column, row));
    picture
}

/// Returns pictures side by side, tops aligned, dark below shorter ones.
pub fn side_by_side(pictures: &[&Image<Srgb>]) -> Image<Srgb> {
    let width = pictures.iter().map(|picture| picture.width).sum();
    let height = pictures.iter().map(|picture| picture.height).max().unwrap_or(0);
    let mut all = Image::from_fn(width, height, |_, _| GROUND);
    let mut left = 0;
    for picture in pictures {
        let place = Rectangle {
            left,
            top: 0,
            width: picture.width,
            height: picture.height,
        };
        paste(&mut all, place, |column, row| picture.at(column, row));
        left += picture.width;
    }
    all
}

/// Returns the least of 1, 2, 5 times a power of ten that `share` of the values do not exceed.
///
/// Values below zero do not count. Extremes: at least 1e-6, at most 1e30.
pub fn round_upper_limit(values: &[f32], share: f64) -> f64 {
    let top = f64::from(quantile(values, share));
    let steps = (-6..=30).flat_map(|power| [1, 2, 5].map(|digit| format!("{digit}e{power}")));
    steps
        .filter_map(|text| text.parse::<f64>().ok())
        .find(|step| *step >= top)
        .unwrap_or(1e30)
}

/// Returns the value that `share` of the values do not exceed. Values below zero do not count. Without any it is 0.
pub fn quantile(values: &[f32], share: f64) -> f32 {
    let mut sorted: Vec<f32> = values.iter().copied().filter(|value| *value >= 0.0).collect();
    sorted.sort_unstable_by(f32::total_cmp);
    let last = sorted.len().saturating_sub(1);
    let place = ((last as f64 * share + 0.5) as usize).min(last);
    sorted.get(place).copied().unwrap_or(0.0)
}

/// Before the label of the highest colour where a value is above the scale.
const ABOVE: &str = ">=";

/// Returns the label of the highest colour.
fn top_label(values: &[f32], scale: &ColorScale) -> String {
    if values.iter().any(|value| f64::from(*value) > scale.high) {
        format!("{ABOVE}{}", scale.high)
    } else {
        scale.high.to_string()
    }
}

/// A part of a picture, pixels.
#[derive(Clone, Copy)]
struct Rectangle {
    left: u32,
    top: u32,
    width: u32,
    height: u32,
}

/// Draws a rectangle from a function of its (column, row).
fn paste(picture: &mut Image<Srgb>, place: Rectangle, color: impl Fn(u32, u32) -> [u8; 3]) {
    let Rectangle { left, top, .. } = place;
    for row in 0..place.height.min(picture.height.saturating_sub(top)) {
        for column in 0..place.width.min(picture.width.saturating_sub(left)) {
            let pixel = (top + row) as usize * picture.width as usize + (left + column) as usize;
            picture.pixels[pixel] = color(column, row);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::font::INK;

    fn scale() -> ColorScale {
        ColorScale::linear("standard deviation", "of white", 0.05, Palette::Inferno)
    }

    #[test]
    fn equal_factors_are_equal_steps_of_colour_on_a_logarithmic_scale() {
        let scale = ColorScale {
            high: 50.0,
            ..scale()
        }
        .over_decades(2);
        assert_eq!((scale.low, scale.unit.as_str()), (0.5, "of white, log"));
        let shares = [
            (0.0, 0.0),
            (0.5, 0.0),
            (1.0, 0.150_515),
            (5.0, 0.5),
            (50.0, 1.0),
            (f32::MAX, 1.0),
        ];
        for (value, share) in shares {
            assert_eq!(scale.color(value), Palette::Inferno.color(share), "{value}");
        }
        assert_eq!(scale.color(-1.0), NO_VALUE);
        assert_eq!(scale.color(f32::NAN), Palette::Inferno.color(0.0));
        // The least scale there is, and one whose low end no decimal is.
        assert_eq!(
            ColorScale {
                high: 1e-6,
                ..scale.clone()
            }
            .over_decades(4)
            .color(1e-6),
            Palette::Inferno.color(1.0)
        );
        let picture = draw_map(
            &[0.02; 4],
            2,
            2,
            &ColorScale { high: 0.2, ..scale }.over_decades(2),
        );
        assert!(
            picture.width < 200,
            "{} pixels for the label of 0.002",
            picture.width
        );
    }

    #[test]
    fn the_ends_of_the_scale_are_one_two_or_five() {
        let cases = [
            (vec![0.0], 1e-6),
            (vec![], 1e-6),
            (vec![0.03, 0.049], 0.05),
            (vec![0.051], 0.1),
            (vec![-1.0, 3.0], 5.0),
            (vec![f32::MAX], 1e30),
        ];
        for (values, top) in cases {
            assert_eq!(round_upper_limit(&values, 1.0), top, "{values:?}");
        }
        let mut mostly_small = vec![0.01; 99];
        mostly_small.push(9.0);
        assert_eq!(round_upper_limit(&mostly_small, 0.98), 0.01);
    }

    #[test]
    fn a_map_has_its_colours_between_title_and_scale() {
        let values: Vec<f32> = (0..300 * 20).map(|index| (index % 300) as f32 / 6000.0).collect();
        let picture = draw_map(&values, 300, 20, &scale());
        assert_eq!(picture.width, 300);
        let row = 2 * 3 + HEIGHT_PX;
        assert_eq!(picture.at(0, row), Palette::Inferno.color(0.0));
        assert_eq!(picture.at(299, row), Palette::Inferno.color(299.0 / 300.0));
        assert!(picture.pixels.contains(&INK), "no text");
    }

    #[test]
    fn a_pixel_without_a_value_is_gray() {
        let picture = draw_map(&[-1.0; 16], 4, 4, &scale());
        assert_eq!(
            picture.pixels.iter().filter(|pixel| **pixel == NO_VALUE).count(),
            16
        );
    }

    /// Frames of a film have one size, and a feature in one panel is at the same row in the next.
    #[test]
    fn maps_on_one_scale_have_one_size_and_a_titled_picture_stands_at_their_height() {
        for width in [8, 60, 300, 960] {
            let map = |value| draw_map(&vec![value; width as usize * 20], width, 20, &scale());
            let (below, above) = (map(0.0), map(7.0));
            assert_eq!(
                (below.width, below.height),
                (above.width, above.height),
                "{width}"
            );
            let image = Image::from_fn(width, 20, |_, _| [9, 99, 199]);
            let beside = draw_titled(&image, "mean");
            assert_eq!(beside.height, below.height, "{width}");
            let first = |picture: &Image<Srgb>, color: [u8; 3]| {
                let row = picture.pixels.iter().position(|pixel| *pixel == color).unwrap();
                row as u32 / picture.width
            };
            let lowest = Palette::Inferno.color(0.0);
            assert_eq!(first(&beside, [9, 99, 199]), first(&below, lowest), "{width}");
        }
    }

    /// A title of 24 letters, and ends and unit of 18.
    #[test]
    fn texts_fit_into_a_map_of_160_pixels_and_grow_with_it() {
        let scale = ColorScale::linear(&"M".repeat(24), "gray levels", 0.05, Palette::Inferno);
        for (width, zoom) in [(160, 1), (319, 1), (320, 2), (1440, 9)] {
            let values = vec![7.0; width as usize * 8];
            let map = draw_map(&values, width, 8, &scale);
            // Two lines of 9 dots and their gaps of 3, and the bar of 9 between gaps of 3.
            assert_eq!([map.width, map.height], [width, 8 + 42 * zoom], "{width}");
            let inked = map.pixels.iter().filter(|pixel| **pixel == INK).count() as u32;
            assert_eq!(inked % (zoom * zoom), 0, "{width}");
        }
    }

    #[test]
    fn pictures_stand_side_by_side() {
        let dark = Image::from_fn(2, 3, |_, _| [1, 2, 3]);
        let light = Image::from_fn(1, 1, |_, _| [250, 250, 250]);
        let both = side_by_side(&[&dark, &light]);
        assert_eq!((both.width, both.height), (3, 3));
        assert_eq!(
            (both.at(1, 2), both.at(2, 0), both.at(2, 1)),
            ([1, 2, 3], [250; 3], GROUND)
        );
    }
}
