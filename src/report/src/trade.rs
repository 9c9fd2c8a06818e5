//! Quality against time: the points of a trade, the best for each time, and the effect of each knob.

use marf_cache::Digest;
use maud::{Markup, html};
use serde::{Deserialize, Serialize};

use super::axis::linear_ticks;
use super::format::{duration, number, px};

/// A measured trade of time against quality around a pipeline as it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trade {
    /// The pipeline.
    pub pipeline: String,
    /// Processor, cores used and system that the times were taken on.
    pub machine: String,
    /// Program with version and commit.
    pub program: String,
    /// Points. The first is the pipeline as it is.
    pub points: Vec<Point>,
    /// Effect of one value of one knob, in the order of its points.
    pub effects: Vec<Effect>,
    /// Indices of the points that no other beats in time and quality at once, the fastest first.
    pub front: Vec<usize>,
}

/// A setting of the knobs, and what came of it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// The settings as the command line takes them (`train.scale=2`). Empty: as it is.
    pub sets: Vec<String>,
    /// Its runs, one for each seed.
    pub runs: Vec<PointRun>,
    /// Why it could not be trained.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<String>,
}

/// One training of a point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PointRun {
    /// Its seed.
    pub seed: u64,
    /// Digest of the photos that judge it: PSNR on other photos is another figure. A calibration may hold out
    /// others. Absent in older trades.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub judged_by: Option<Digest>,
    /// Factor by which the photos that judge it were shrunk: PSNR at another factor is another figure.
    #[serde(alias = "scale")]
    pub judged_scale: u32,
    /// Mean PSNR on the photos held out, dB.
    pub psnr: f64,
    /// Mean SSIM on them.
    pub ssim: Option<f64>,
    /// Seconds of calibration and of the training's node, when they were made.
    pub seconds: f64,
    /// Those of them that calibration took.
    pub calibrate_s: f64,
    /// Those of trials and steps.
    pub train_s: f64,
    /// Photos with a camera.
    pub placed: u64,
    /// Root mean square of the reprojection error, pixels.
    pub error_px: Option<f64>,
    /// Median distance of the cameras from known ones, in the unit of these, where some are known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_error: Option<f64>,
    /// Median angle between them, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub angle_error_deg: Option<f64>,
    /// Optimiser steps.
    pub steps: u64,
    /// Numbers that the field learns.
    pub parameters: u64,
    /// Bytes of the weights.
    pub bytes: u64,
    /// Largest memory of the program, MB. 0 if the system does not report it.
    pub peak_mb: u64,
}

/// A value with the interval that holds its mean at 95 %, by Student's t and the variance between seeds in
/// all points together. One seed has no interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Mean over seeds.
    pub mean: f64,
    /// Half its length.
    pub half: Option<f64>,
}

/// Effect of a point with one knob turned, compared seed by seed with the pipeline as it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Effect {
    /// Its point.
    pub point: usize,
    /// PSNR gained, dB.
    pub gain_db: Interval,
    /// Seconds as a share of those as it is.
    pub time: Interval,
}

impl Point {
    /// Returns the settings, or that there are none.
    pub fn name(&self) -> String {
        if self.sets.is_empty() {
            return "as it is".to_owned();
        }
        self.sets.join(" ")
    }

    /// Returns its name as lines of the list below the front, which three settings would leave.
    fn lines(&self) -> Vec<String> {
        if self.sets.is_empty() {
            return vec![self.name()];
        }
        self.sets.chunks(2).map(|sets| sets.join(" ")).collect()
    }

    /// Returns true if it is judged by the same photos as another, at the same size.
    pub fn is_comparable(&self, other: &Self) -> bool {
        let judged = |point: &Self| point.runs.first().map(|run| (run.judged_scale, run.judged_by));
        judged(self).is_some() && judged(self) == judged(other)
    }

    /// Describes a point that is judged by other photos than the pipeline as it is. `None` for all others.
    pub fn apart(&self, base: &Self) -> Option<String> {
        let (run, as_it_is) = (self.runs.first()?, base.runs.first()?);
        if self.is_comparable(base) {
            return None;
        }
        let cameras = run.position_error.zip(as_it_is.position_error);
        let cameras = cameras.map_or_else(String::new, |(error, before)| {
            format!(
                "cameras are off by {} instead of {}, and ",
                number(error),
                number(before)
            )
        });
        Some(format!(
            "{}: its calibration holds out other photos, so its PSNR cannot be compared: {cameras}{}.",
            self.name(),
            self.time_beside(base)?
        ))
    }

    /// Compares its times with those of another point. Only times of repeats that do not overlap differ.
    fn time_beside(&self, base: &Self) -> Option<String> {
        let times = |point: &Self| point.runs.iter().map(|run| run.seconds).collect::<Vec<f64>>();
        let (own, others) = (times(self), times(base));
        let all_below =
            |low: &[f64], high: &[f64]| low.iter().all(|time| high.iter().all(|other| time < other));
        let is_repeated = own.len() > 1 && others.len() > 1;
        if !is_repeated || !(all_below(&own, &others) || all_below(&others, &own)) {
            return Some(NO_DIFFERENCE.to_owned());
        }
        let share = self.means()?.1 / base.means()?.1;
        Some(format!("it takes {:.0} % of the time", 100.0 * share))
    }

    /// Returns the means of PSNR, dB, and seconds. `None` without a run.
    pub fn means(&self) -> Option<(f64, f64)> {
        let mean =
            |value: fn(&PointRun) -> f64| self.runs.iter().map(value).sum::<f64>() / self.runs.len() as f64;
        (!self.runs.is_empty()).then(|| (mean(|run| run.psnr), mean(|run| run.seconds)))
    }
}

impl Interval {
    /// Returns true if the gain may be none: seeds alone change the PSNR by about a tenth of a decibel.
    fn may_be_none(&self) -> bool {
        self.mean.abs() <= self.half.unwrap_or(0.2)
    }
}

/// Said of times that differ by no more than repeats do, or that were not repeated.
const NO_DIFFERENCE: &str = "there is no measurable difference in time";

impl Effect {
    /// Returns a sentence that one can act on.
    pub fn sentence(&self, point: &Point) -> String {
        let (gain, time) = (self.gain_db, self.time);
        let unsure = gain.may_be_none();
        let percent = |share: f64| format!("{:.0} %", share * 100.0);
        let quality = match gain.half {
            Some(half) => format!("{:.2} dB (± {half:.2})", gain.mean.abs()),
            None => format!("{:.2} dB (one seed)", gain.mean.abs()),
        };
        let change = time.mean - 1.0;
        let is_measured = time.half.is_some_and(|half| change.abs() > half);
        let (slower, faster) = (is_measured && change > 0.0, is_measured && change < 0.0);
        let clock = if faster {
            format!("it saves {} of the time", percent(-change))
        } else if slower {
            format!("it takes {} more time", percent(change))
        } else {
            NO_DIFFERENCE.to_owned()
        };
        let (what, advice) = match (unsure, gain.mean > 0.0) {
            (true, _) if faster => (
                format!("changes the quality by no more than seeds do, {quality}"),
                "Take it",
            ),
            (true, _) if slower => (
                format!("changes the quality by no more than seeds do, {quality}"),
                "Leave it",
            ),
            (true, _) => (
                format!("changes nothing that these seeds can show, {quality}"),
                "It does not matter",
            ),
            (false, true) if slower => (format!("gains {quality}"), "Use it if there is time"),
            (false, true) => (format!("gains {quality}"), "Take it"),
            (false, false) if faster => (format!("costs {quality}"), "Use it if it must be fast"),
            (false, false) => (format!("costs {quality}"), "Leave it"),
        };
        format!("{}: {what}, and {clock}. {advice}.", point.name())
    }
}

/// Shows a trade: the front, the effects and their sentences.
pub(super) fn body(trade: &Trade) -> Markup {
    let seeds = trade.points.first().map_or(0, |base| base.runs.len());
    html! {
        p {
            (trade.points.len()) " settings, " (seeds) " seeds each where one knob is turned, measured on " (trade.machine) ". Seconds are those of \
             calibration and training with its judging, by photos of one size."
        }
        div.scroll { (front(trade)) }
        ul {
            @for effect in &trade.effects { li { (effect.sentence(&trade.points[effect.point])) } }
            @for sentence in trade.points.iter().filter_map(|point| point.apart(trade.points.first()?)) { li { (sentence) } }
        }
        div.scroll { (effects(trade)) }
        details {
            summary { "all settings" }
            (table(trade))
        }
    }
}

fn table(trade: &Trade) -> Markup {
    let mut runs = trade.points.iter().flat_map(|point| &point.runs);
    let is_known = runs.any(|run| run.position_error.is_some());
    let error = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), number);
    html! {
        table {
            thead { tr {
                th { "setting" } th.number { "PSNR, dB" } th.number { "time" } th.number { "fastest" } th.number { "slowest" }
                th.number { "steps" } th.number { "parameters" } th.number { "weights, MB" } th.number { "memory, MB" }
                @if is_known { th.number { "cameras off by" } th.number { "and by, degrees" } }
            } }
            @for (index, point) in trade.points.iter().enumerate() {
                tr.best[trade.front.contains(&index)] {
                    td { (point.name()) }
                    @match (point.means(), point.runs.first()) {
                        (Some((psnr, time)), Some(run)) => {
                            td.number { (format!("{psnr:.2}")) }
                            td.number { (duration(time)) }
                            @let times = || point.runs.iter().map(|run| run.seconds);
                            td.number { (duration(times().fold(f64::INFINITY, f64::min))) }
                            td.number { (duration(times().fold(0.0, f64::max))) }
                            td.number { (number(run.steps as f64)) }
                            td.number { (number(run.parameters as f64)) }
                            td.number { (format!("{:.1}", run.bytes as f64 / 1e6)) }
                            td.number { (number(run.peak_mb as f64)) }
                            @if is_known {
                                td.number { (error(run.position_error)) }
                                td.number { (error(run.angle_error_deg)) }
                            }
                        }
                        _ => td colspan=(if is_known { "10" } else { "8" }) { (point.fault.as_deref().unwrap_or("not trained")) }
                    }
                }
            }
        }
    }
}

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 420.0;
const LEFT: f64 = 60.0;
const RIGHT: f64 = 24.0;
const TOP: f64 = 16.0;
const BOTTOM: f64 = 46.0;
/// Room of a name in the drawing of effects.
const NAMES: f64 = 290.0;
/// Room of a time there, and of half a dot next to it.
const TIMES: f64 = 110.0;
const ROW: f64 = 20.0;

/// Where drawings take their colours from when they stand alone.
const STYLE: &str = "svg.trade{font:12px system-ui,sans-serif;background:#fdfcfa;color:#23201c}\
    @media(prefers-color-scheme:dark){svg.trade{background:#191715;color:#e9e4dc}}";

/// Returns a drawing as a file of its own, with its style.
pub fn file(drawing: &Markup) -> String {
    let style = format!("><style>{STYLE}</style>");
    drawing
        .0
        .replacen("<svg ", "<svg xmlns=\"http://www.w3.org/2000/svg\" ", 1)
        .replacen('>', &style, 1)
}

/// Height of a row of the list below the front.
const LIST_ROW: f64 = 16.0;

/// Draws PSNR against time, which is shown by its logarithm, with the front as a line and its points listed by number.
pub fn front(trade: &Trade) -> Markup {
    let places: Vec<(usize, f64, f64)> = trade
        .points
        .iter()
        .enumerate()
        .filter(|(_, point)| point.is_comparable(&trade.points[0]))
        .filter_map(|(index, point)| point.means().map(|(psnr, time)| (index, time, psnr)))
        .collect();
    let span = |values: &dyn Fn(&(usize, f64, f64)) -> f64| {
        let least = places.iter().map(values).fold(f64::INFINITY, f64::min);
        let most = places.iter().map(values).fold(f64::NEG_INFINITY, f64::max);
        let margin = 0.06 * (most - least).max(0.1);
        (least - margin, most + margin)
    };
    let (first, last) = span(&|place| place.1.log2());
    let (low, high) = span(&|place| place.2);
    let x_of = |time: f64| LEFT + (time.log2() - first) / (last - first) * (WIDTH - LEFT - RIGHT);
    let y_of = |psnr: f64| TOP + (high - psnr) / (high - low) * (HEIGHT - TOP - BOTTOM);
    let times = time_ticks(first, last);
    let step = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0]
        .into_iter()
        .find(|step| (high - low) / step <= 8.0)
        .unwrap_or(10.0);
    let psnrs = ((low / step).ceil() as i64..=(high / step).floor() as i64).map(|tick| tick as f64 * step);
    let best = trade
        .front
        .iter()
        .filter_map(|index| Some((*index, trade.points[*index].means()?)));
    let best: Vec<(usize, (f64, f64))> = best.collect();
    let line: Vec<String> = best
        .iter()
        .map(|(_, (psnr, time))| format!("{},{}", px(x_of(*time)), px(y_of(*psnr))))
        .collect();
    let rows = |index: usize| trade.points[index].lines();
    let count: usize = best.iter().map(|(index, _)| rows(*index).len()).sum();
    let height = HEIGHT + LIST_ROW * (count as f64 + 0.5);
    let list = best.iter().scan(HEIGHT + 0.5 * LIST_ROW, |next, (index, means)| {
        let (top, lines) = (*next, rows(*index));
        *next += LIST_ROW * lines.len() as f64;
        Some((top, lines, *means))
    });
    html! {
        svg.trade viewBox={ "0 0 " (px(WIDTH)) " " (px(height)) } width=(px(WIDTH))
            height=(px(height)) role="img" aria-label="PSNR against time" {
            @for time in times {
                line x1=(px(x_of(time))) x2=(px(x_of(time))) y1=(px(TOP)) y2=(px(HEIGHT - BOTTOM)) stroke="currentColor" stroke-opacity="0.15" {}
                text x=(px(x_of(time))) y=(px(HEIGHT - BOTTOM + 16.0)) text-anchor="middle" fill="currentColor" { (duration(time)) }
            }
            @for psnr in psnrs {
                line x1=(px(LEFT)) x2=(px(WIDTH - RIGHT)) y1=(px(y_of(psnr))) y2=(px(y_of(psnr))) stroke="currentColor" stroke-opacity="0.15" {}
                text x=(px(LEFT - 6.0)) y=(px(y_of(psnr) + 4.0)) text-anchor="end" fill="currentColor" { (number((psnr * 10.0).round() / 10.0)) }
            }
            text x=(px((LEFT + WIDTH - RIGHT) / 2.0)) y=(px(HEIGHT - 8.0)) text-anchor="middle" fill="currentColor" { "time, calibration and training" }
            text transform={ "translate(14 " (px(HEIGHT / 2.0)) ") rotate(-90)" } text-anchor="middle" fill="currentColor" { "PSNR, dB" }
            polyline points=(line.join(" ")) fill="none" stroke="#33658a" stroke-width="2" {}
            @for (index, time, psnr) in &places {
                @let on_front = trade.front.contains(index);
                @let colour = match (*index, on_front) { (0, _) => "#c7641b", (_, true) => "#33658a", _ => "#a89f92" };
                circle cx=(px(x_of(*time))) cy=(px(y_of(*psnr))) r=(if *index == 0 { "6" } else { "4" }) fill=(colour) {
                    title { (trade.points[*index].name()) ": " (format!("{psnr:.2} dB, ")) (duration(*time)) }
                }
            }
            @for (rank, (_, (psnr, time))) in best.iter().enumerate() {
                text x=(px(x_of(*time) - 5.0)) y=(px(y_of(*psnr) - 7.0)) text-anchor="end" fill="currentColor" font-size="11" { (rank + 1) }
            }
            @for (rank, (y, lines, (psnr, time))) in list.enumerate() {
                text x="30" y=(px(y)) text-anchor="end" fill="currentColor" { (rank + 1) }
                text x=(px(LEFT + 60.0)) y=(px(y)) text-anchor="end" fill="currentColor" { (duration(time)) }
                text x=(px(LEFT + 125.0)) y=(px(y)) text-anchor="end" fill="currentColor" { (format!("{psnr:.2} dB")) }
                @for (line, settings) in lines.iter().enumerate() {
                    text x=(px(LEFT + 140.0)) y=(px(y + LIST_ROW * line as f64)) fill="currentColor" { (settings) }
                }
            }
        }
    }
}

/// Returns times to mark, seconds, between two given by their binary logarithms: powers of two, or round ones where those are fewer than two.
fn time_ticks(first: f64, last: f64) -> Vec<f64> {
    let inside = |time: &f64| (first..last).contains(&time.log2());
    let powers: Vec<f64> = (-10..30).map(|power| 2_f64.powi(power)).filter(inside).collect();
    match powers.len() {
        0 | 1 => linear_ticks([first, last].into_iter().map(f64::exp2))
            .into_iter()
            .filter(inside)
            .collect(),
        _ => powers,
    }
}

/// Draws what each setting gains, dB, with its interval, and the share of the time it takes.
pub fn effects(trade: &Trade) -> Markup {
    let most = trade
        .effects
        .iter()
        .map(|effect| effect.gain_db.mean.abs() + effect.gain_db.half.unwrap_or(0.0))
        .fold(0.1, f64::max)
        .min(
            trade
                .effects
                .iter()
                .map(|effect| effect.gain_db.mean.abs())
                .fold(0.1, f64::max)
                * 1.5,
        );
    let height = TOP + ROW * (trade.effects.len() as f64 + 2.0);
    let plot = WIDTH - NAMES - TIMES;
    let x_of = |gain: f64| NAMES + (gain / most + 1.0) / 2.0 * plot;
    let clamped = |gain: f64| px(x_of(gain.clamp(-most, most)));
    html! {
        svg.trade viewBox={ "0 0 " (px(WIDTH)) " " (px(height)) } width=(px(WIDTH)) height=(px(height))
            role="img" aria-label="What each setting gains" {
            line x1=(px(x_of(0.0))) x2=(px(x_of(0.0))) y1=(px(TOP)) y2=(px(height - ROW)) stroke="currentColor" stroke-opacity="0.4" {}
            @for (row, effect) in trade.effects.iter().enumerate() {
                @let y = TOP + ROW * (row as f64 + 0.5);
                @let gain = effect.gain_db;
                @let half = gain.half.unwrap_or(0.0);
                text x=(px(NAMES - 8.0)) y=(px(y + 4.0)) text-anchor="end" fill="currentColor" { (trade.points[effect.point].name()) }
                line x1=(clamped(gain.mean - half)) x2=(clamped(gain.mean + half)) y1=(px(y)) y2=(px(y)) stroke="currentColor" stroke-opacity="0.5" {}
                circle cx=(clamped(gain.mean)) cy=(px(y)) r="4" fill=(if gain.mean < 0.0 { "#c7641b" } else { "#2f6f4f" }) {
                    title { (format!("{:+.2} dB ± {half:.2}", gain.mean)) }
                }
                text x=(px(WIDTH - 6.0)) y=(px(y + 4.0)) text-anchor="end" fill="currentColor" { (format!("{:.2} x time", effect.time.mean)) }
            }
            @for gain in [-most, 0.0, most] {
                text x=(px(x_of(gain))) y=(px(height - 4.0)) text-anchor="middle" fill="currentColor" { (format!("{gain:+.1} dB")) }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn effect(gain: f64, half: f64, time: f64) -> Effect {
        let interval = |mean, half| Interval {
            mean,
            half: Some(half),
        };
        Effect {
            point: 1,
            gain_db: interval(gain, half),
            time: interval(time, 0.01),
        }
    }

    /// An effect without a gain whose repeats differ in time by `half`.
    fn noisy(time: f64, half: f64) -> Effect {
        let time = Interval {
            mean: time,
            half: Some(half),
        };
        Effect {
            time,
            ..effect(0.05, 0.1, 1.0)
        }
    }

    #[test]
    fn a_point_judged_by_other_photos_is_told_apart() {
        let mut base = crate::fixture_documents::trade().points[0].clone();
        base.runs[0].judged_by = Some(Digest::from_content(b"a"));
        base.runs[0].position_error = Some(0.5);
        let mut repeat = base.runs[0];
        repeat.seconds += 1.0;
        base.runs.push(repeat);
        let mut point = base.clone();
        assert_eq!(point.apart(&base), None);
        point.sets = vec!["calibrate.pairs=\"sequential\"".to_owned()];
        point.runs[0].judged_by = Some(Digest::from_content(b"b"));
        point.runs[0].position_error = Some(0.25);
        for run in &mut point.runs {
            run.seconds /= 2.0;
        }
        assert!(!point.is_comparable(&base));
        let said = "calibrate.pairs=\"sequential\": its calibration holds out other photos, so its PSNR cannot be compared: cameras are off by \
             0.25 instead of 0.5, and ";
        assert_eq!(
            point.apart(&base).unwrap(),
            format!("{said}it takes 50 % of the time.")
        );
        // Times that overlap, and a time that was taken once, show nothing.
        point.runs[0].seconds = base.runs[1].seconds;
        let unsure = format!("{said}there is no measurable difference in time.");
        assert_eq!(point.apart(&base).unwrap(), unsure);
        point.runs.truncate(1);
        point.runs[0].seconds /= 9.0;
        assert_eq!(point.apart(&base).unwrap(), unsure);
        assert_eq!(Point::default().apart(&base), None);
    }

    #[test]
    fn times_close_together_are_marked_at_round_ones() {
        assert_eq!(time_ticks(2.5, 5.5), [8.0, 16.0, 32.0]);
        let close = time_ticks(20_f64.log2(), 29_f64.log2());
        assert!(
            close.len() >= 3 && close.iter().all(|time| time % 1.0 == 0.0),
            "{close:?}"
        );
        assert!(!time_ticks(20_f64.log2(), 20.4_f64.log2()).is_empty());
    }

    #[test]
    fn every_effect_ends_in_advice() {
        let point = Point {
            sets: vec!["train.scale=2".to_owned()],
            runs: Vec::new(),
            fault: None,
        };
        for (effect, sentence) in [
            (
                effect(-0.9, 0.1, 0.45),
                "train.scale=2: costs 0.90 dB (± 0.10), and it saves 55 % of the time. Use it if it must be fast.",
            ),
            (
                effect(0.5, 0.1, 2.0),
                "train.scale=2: gains 0.50 dB (± 0.10), and it takes 100 % more time. Use it if there is time.",
            ),
            (
                effect(0.5, 0.1, 1.005),
                "train.scale=2: gains 0.50 dB (± 0.10), and there is no measurable difference in time. Take it.",
            ),
            (
                effect(-0.5, 0.1, 1.5),
                "train.scale=2: costs 0.50 dB (± 0.10), and it takes 50 % more time. Leave it.",
            ),
            (
                effect(0.05, 0.1, 0.5),
                "train.scale=2: changes the quality by no more than seeds do, 0.05 dB (± 0.10), and it saves 50 % of the time. Take it.",
            ),
            (
                noisy(0.78, 0.3),
                "train.scale=2: changes nothing that these seeds can show, 0.05 dB (± 0.10), and there is no measurable difference in time. It does not matter.",
            ),
            (
                effect(0.05, 0.1, 1.0),
                "train.scale=2: changes nothing that these seeds can show, 0.05 dB (± 0.10), and there is no measurable difference in time. It does not matter.",
            ),
        ] {
            assert_eq!(effect.sentence(&point), sentence);
        }
        let alone = |mean| Interval { mean, half: None };
        let once = Effect {
            gain_db: alone(-3.0),
            time: alone(0.5),
            ..effect(0.0, 0.0, 0.5)
        };
        assert_eq!(
            once.sentence(&point),
            "train.scale=2: costs 3.00 dB (one seed), and there is no measurable difference in time. Leave it."
        );
    }

    #[test]
    fn the_list_below_the_front_has_a_line_for_each_two_settings() {
        let with = |sets: &[&str]| Point {
            sets: sets.iter().copied().map(str::to_owned).collect(),
            ..Point::default()
        };
        assert_eq!(with(&[]).lines(), ["as it is"]);
        assert_eq!(with(&["a=1", "b=2"]).lines(), ["a=1 b=2"]);
        assert_eq!(with(&["a=1", "b=2", "c=3"]).lines(), ["a=1 b=2", "c=3"]);

        let mut trade = crate::fixture_documents::trade();
        let drawn_rows = |trade: &Trade| {
            let drawn = front(trade).into_string();
            let rows = drawn.matches("x=\"200\"").count();
            (rows, drawn)
        };
        let (rows, _) = drawn_rows(&trade);
        let index = trade.front[0];
        trade.points[index].sets = ["a=1", "b=2", "c=3"].map(str::to_owned).into();
        let (more, drawn) = drawn_rows(&trade);
        assert_eq!(more, rows + 1, "{drawn}");
        let height = px(HEIGHT + LIST_ROW * (more as f64 + 0.5));
        assert!(drawn.contains(&format!("height=\"{height}\"")), "{drawn}");
    }
}
