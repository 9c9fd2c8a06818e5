//! Line charts as SVG: ticks at round numbers, a grid, a line or some with a legend.

use maud::{Markup, html};

use super::format::{number, px};

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 260.0;
const LEFT: f64 = 62.0;
const RIGHT: f64 = 16.0;
const TOP: f64 = 14.0;
const BOTTOM: f64 = 42.0;
/// Height of a row of the legend.
const LEGEND_ROW: f64 = 18.0;

/// Scale of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scale {
    /// Equal differences, equal steps.
    Linear,
    /// Equal ratios, equal steps. Values of 0 and below are left out.
    Log,
}

/// A line: its name, empty for the only one, and its points by x. Points that are not finite are left out.
pub(super) type Line<'a> = (&'a str, Vec<(f64, f64)>);

/// A chart.
pub(super) struct Chart<'a> {
    /// Description, for screen readers.
    pub(super) title: &'a str,
    /// Quantity and unit along x.
    pub(super) x_label: &'a str,
    /// Quantity and unit along y.
    pub(super) y_label: &'a str,
    /// Scale of y.
    pub(super) scale: Scale,
    /// Its lines, at most four, which differ by colour and dashes.
    pub(super) lines: Vec<Line<'a>>,
}

impl Chart<'_> {
    /// Draws the chart, or a sentence that there is nothing to draw.
    pub(super) fn drawn(&self) -> Markup {
        let drawable = |points: &[(f64, f64)]| -> Vec<(f64, f64)> {
            points
                .iter()
                .copied()
                .filter(|(x, y)| self.can_draw(*x, *y))
                .collect()
        };
        let lines = self.lines.iter().map(|(name, points)| (*name, drawable(points)));
        let lines: Vec<(usize, Line<'_>)> = lines
            .enumerate()
            .filter(|(_, (_, points))| !points.is_empty())
            .collect();
        let points: Vec<(f64, f64)> = lines
            .iter()
            .flat_map(|(_, (_, points))| points.iter().copied())
            .collect();
        if points.is_empty() {
            return html! { p.missing { (self.title) ": no value is recorded." } };
        }
        let x_ticks = linear_ticks(points.iter().map(|point| point.0));
        let y_ticks = match self.scale {
            Scale::Linear => linear_ticks(points.iter().map(|point| point.1)),
            Scale::Log => log_ticks(points.iter().map(|point| point.1)),
        };
        let x_of = |x: f64| LEFT + share(x, &x_ticks, Scale::Linear) * (WIDTH - LEFT - RIGHT);
        let y_of = |y: f64| HEIGHT - BOTTOM - share(y, &y_ticks, self.scale) * (HEIGHT - TOP - BOTTOM);
        // The legend is above the plot.
        let named = lines.iter().filter(|(_, (name, _))| !name.is_empty()).count();
        let legend_height = LEGEND_ROW * named as f64;
        let (above, height) = (px(-legend_height), px(HEIGHT + legend_height));
        html! {
            figure {
                figcaption { (self.title) }
                svg.chart viewBox={ "0 " (above) " " (px(WIDTH)) " " (height) } width=(px(WIDTH)) height=(height)
                    role="img" aria-label=(self.title) {
                    @for tick in &y_ticks { (y_tick(*tick, y_of(*tick))) }
                    @for tick in &x_ticks { (x_tick(*tick, x_of(*tick))) }
                    text.label x=(px((LEFT + WIDTH - RIGHT) / 2.0)) y=(px(HEIGHT - 6.0)) text-anchor="middle" { (self.x_label) }
                    text.label transform={ "translate(13 " (px((TOP + HEIGHT - BOTTOM) / 2.0)) ") rotate(-90)" }
                        text-anchor="middle" { (self.y_label) }
                    @for (row, (index, (name, points))) in lines.iter().enumerate() {
                        g class={ "line" (index) } {
                            polyline points=(polyline(points.iter().map(|(x, y)| (x_of(*x), y_of(*y))))) {}
                            @for (x, y) in points {
                                circle cx=(px(x_of(*x))) cy=(px(y_of(*y))) r="3" {
                                    title { (name) " " (self.x_label) " " (number(*x)) ", " (self.y_label) " " (number(*y)) }
                                }
                            }
                            @if !name.is_empty() { (legend(row, name)) }
                        }
                    }
                }
            }
        }
    }

    fn can_draw(&self, x: f64, y: f64) -> bool {
        x.is_finite() && y.is_finite() && (self.scale == Scale::Linear || y > 0.0)
    }
}

fn y_tick(value: f64, y: f64) -> Markup {
    html! {
        line.grid x1=(px(LEFT)) x2=(px(WIDTH - RIGHT)) y1=(px(y)) y2=(px(y)) {}
        text.tick x=(px(LEFT - 7.0)) y=(px(y + 4.0)) text-anchor="end" { (short(value)) }
    }
}

fn x_tick(value: f64, x: f64) -> Markup {
    html! {
        line.grid x1=(px(x)) x2=(px(x)) y1=(px(TOP)) y2=(px(HEIGHT - BOTTOM)) {}
        text.tick x=(px(x)) y=(px(HEIGHT - BOTTOM + 16.0)) text-anchor="middle" { (short(value)) }
    }
}

/// A piece of the line and its name, above the plot.
fn legend(row: usize, name: &str) -> Markup {
    let y = -LEGEND_ROW * (row as f64 + 0.5);
    let (end, begin) = (WIDTH - RIGHT - 8.0, WIDTH - RIGHT - 38.0);
    html! {
        polyline points=(polyline([(begin, y), (end, y)].into_iter())) {}
        text.tick x=(px(begin - 6.0)) y=(px(y + 4.0)) text-anchor="end" { (name) }
    }
}

fn polyline(places: impl Iterator<Item = (f64, f64)>) -> String {
    let texts: Vec<String> = places.map(|(x, y)| format!("{},{}", px(x), px(y))).collect();
    texts.join(" ")
}

/// A tick needs no zeros behind: 12.5, not 12.50.
fn short(value: f64) -> String {
    if value != 0.0 && !(1e-3..1e6).contains(&value.abs()) {
        return format!("{value:.0e}");
    }
    // Ticks are multiples of a round step: six decimals are exact.
    let rounded = (value * 1e6).round() / 1e6;
    format!("{}", rounded + 0.0)
}

/// Returns the place of a value between the first tick (0) and the last (1).
fn share(value: f64, ticks: &[f64], scale: Scale) -> f64 {
    let of = |value: f64| match scale {
        Scale::Linear => value,
        Scale::Log => value.log10(),
    };
    let (first, last) = (ticks.first().copied(), ticks.last().copied());
    let (first, last) = (of(first.unwrap_or(0.0)), of(last.unwrap_or(1.0)));
    if last > first {
        (of(value) - first) / (last - first)
    } else {
        0.5
    }
}

/// Five to ten multiples of 1, 2 or 5 times a power of ten that enclose all values.
pub(super) fn linear_ticks(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let (low, high) = range(values);
    // A flat line gets a margin above and below, else it would coincide with the frame.
    let (low, high) = if high > low {
        (low, high)
    } else {
        (low - low.abs().max(1.0) * 0.5, high + high.abs().max(1.0) * 0.5)
    };
    let step = round_step((high - low) / 6.0);
    let (first, last) = ((low / step).floor(), (high / step).ceil());
    // Beyond 2^53 steps a step is below the precision of the values.
    if !(first.is_finite() && last.is_finite()) || last - first > 100.0 {
        return vec![low, high];
    }
    (0..=(last - first) as u32)
        .map(|index| (first + f64::from(index)) * step)
        .collect()
}

/// Powers of ten that enclose all values, with 2 and 5 between where they are few.
pub(super) fn log_ticks(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let (low, high) = range(values);
    let (first, last) = (low.log10().floor(), high.log10().ceil());
    if !(first.is_finite() && last.is_finite()) {
        return vec![0.1, 1.0];
    }
    let marks: &[f64] = if last - first <= 3.0 {
        &[1.0, 2.0, 5.0]
    } else {
        &[1.0]
    };
    let all: Vec<f64> = (first as i32..=last as i32)
        .flat_map(|power| marks.iter().map(move |mark| mark * 10_f64.powi(power)))
        .collect();
    let from = all.iter().rposition(|tick| *tick <= low).unwrap_or(0);
    let to = all.iter().position(|tick| *tick >= high).unwrap_or(all.len() - 1);
    let to = if to > from {
        to
    } else {
        (from + 1).min(all.len() - 1)
    };
    all[from..=to].to_vec()
}

fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    })
}

/// The round step (1, 2 or 5 times a power of ten) that is not smaller.
pub(super) fn round_step(least: f64) -> f64 {
    let power = 10_f64.powf(least.log10().floor());
    let mark = [1.0, 2.0, 5.0]
        .into_iter()
        .find(|mark| mark * power >= least * (1.0 - 1e-9));
    mark.unwrap_or(10.0) * power
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_enclose_the_values() {
        assert_eq!(
            linear_ticks([0.0, 60.0].into_iter()),
            [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0]
        );
        assert_eq!(
            linear_ticks([21.3, 27.9].into_iter()),
            [20.0, 22.0, 24.0, 26.0, 28.0]
        );
        assert_eq!(
            log_ticks([0.013, 0.4].into_iter()),
            [0.01, 0.02, 0.05, 0.1, 0.2, 0.5]
        );
        for (low, high) in [
            (0.0, 0.0),
            (-1e9, 1e9),
            (1e-12, 2e-12),
            (5.0, 5.0),
            (1e300, 2e300),
            (1e16, 1e16 + 2.0),
        ] {
            let ticks = linear_ticks([low, high].into_iter());
            assert!(ticks.len() >= 2 && ticks.len() < 102, "{low} {high}: {ticks:?}");
            assert!(
                ticks[0] <= low && ticks[ticks.len() - 1] >= high,
                "{low} {high}: {ticks:?}"
            );
        }
    }

    #[test]
    fn log_ticks_enclose_one_value_and_many_decades() {
        for (low, high) in [(1.0, 1.0), (0.3, 0.3), (1e-9, 1e9), (f64::MIN_POSITIVE, 1.0)] {
            let ticks = log_ticks([low, high].into_iter());
            assert!(ticks.len() >= 2, "{low} {high}: {ticks:?}");
            assert!(
                ticks[0] <= low && ticks[ticks.len() - 1] >= high,
                "{low} {high}: {ticks:?}"
            );
        }
    }

    #[test]
    fn a_chart_leaves_out_what_it_cannot_draw() {
        let points = vec![(0.0, f64::NAN), (1.0, 0.0), (2.0, -1.0), (3.0, 0.5)];
        let chart = |points: Vec<(f64, f64)>, scale| Chart {
            title: "loss",
            x_label: "step",
            y_label: "loss",
            scale,
            lines: vec![("", points)],
        };
        let drawn = chart(points, Scale::Log).drawn().into_string();
        assert_eq!(drawn.matches("<circle").count(), 1, "{drawn}");
        assert!(!drawn.contains("NaN"), "{drawn}");
        let empty = chart(vec![(f64::NAN, 1.0)], Scale::Linear).drawn().into_string();
        assert!(empty.contains("no value is recorded"), "{empty}");
    }

    #[test]
    fn lines_share_their_axes_and_have_names() {
        let line = |top: f64| vec![(0.0, 0.0), (1.0, top)];
        let chart = Chart {
            title: "shares",
            x_label: "stated",
            y_label: "inside",
            scale: Scale::Linear,
            lines: vec![("found", line(0.5)), ("<ideal>", line(1.0))],
        };
        let drawn = chart.drawn().into_string();
        assert_eq!(
            drawn.matches("<polyline").count(),
            4,
            "two lines and their legend: {drawn}"
        );
        assert!(
            drawn.contains("&lt;ideal&gt;") && drawn.contains("line1"),
            "{drawn}"
        );
        let highest = |class: &str| {
            drawn
                .split(class)
                .nth(1)
                .unwrap()
                .split("points=\"")
                .nth(1)
                .unwrap()
                .split(' ')
                .nth(1)
                .unwrap()
        };
        let height = |point: &str| {
            point
                .split(&[',', '"'][..])
                .nth(1)
                .unwrap()
                .parse::<f64>()
                .unwrap()
        };
        assert!(
            height(highest("line0")) > height(highest("line1")),
            "0.5 lies below 1"
        );
    }
}
