//! Drawings, sentences and table of a trade.

use maud::{Markup, html};

use super::axis::linear_ticks;
use super::format::{duration, number, px};
use super::trade::Trade;

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
    html! {
        table {
            thead { tr {
                th { "setting" } th.number { "PSNR, dB" } th.number { "time" } th.number { "fastest" } th.number { "slowest" }
                th.number { "steps" } th.number { "parameters" } th.number { "weights, MB" } th.number { "memory, MB" }
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
                        }
                        _ => td colspan="8" { (point.fault.as_deref().unwrap_or("not trained")) }
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
    use crate::trade::Point;

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
