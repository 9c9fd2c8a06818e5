//! Quality against time: the points of a trade, the best for each time, and the effect of each knob.

use marf_cache::Digest;
use serde::{Deserialize, Serialize};

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
    pub(super) fn lines(&self) -> Vec<String> {
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
        if self.runs.is_empty() || base.runs.is_empty() || self.is_comparable(base) {
            return None;
        }
        Some(format!(
            "{}: its calibration holds out other photos, so its PSNR cannot be compared: {}.",
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
const NO_DIFFERENCE: &str = "the time does not differ measurably";

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
        let mut repeat = base.runs[0];
        repeat.seconds += 1.0;
        base.runs.push(repeat);
        let mut point = base.clone();
        assert_eq!(point.apart(&base), None);
        point.sets = vec!["calibrate.pairs=\"sequential\"".to_owned()];
        point.runs[0].judged_by = Some(Digest::from_content(b"b"));
        for run in &mut point.runs {
            run.seconds /= 2.0;
        }
        assert!(!point.is_comparable(&base));
        let said = "calibrate.pairs=\"sequential\": its calibration holds out other photos, so its PSNR cannot be compared: ";
        assert_eq!(
            point.apart(&base).unwrap(),
            format!("{said}it takes 50 % of the time.")
        );
        // Times that overlap, and a time that was taken once, show nothing.
        point.runs[0].seconds = base.runs[1].seconds;
        let unsure = format!("{said}the time does not differ measurably.");
        assert_eq!(point.apart(&base).unwrap(), unsure);
        point.runs.truncate(1);
        point.runs[0].seconds /= 9.0;
        assert_eq!(point.apart(&base).unwrap(), unsure);
        assert_eq!(Point::default().apart(&base), None);
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
                "train.scale=2: gains 0.50 dB (± 0.10), and the time does not differ measurably. Take it.",
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
                "train.scale=2: changes nothing that these seeds can show, 0.05 dB (± 0.10), and the time does not differ measurably. It does not matter.",
            ),
            (
                effect(0.05, 0.1, 1.0),
                "train.scale=2: changes nothing that these seeds can show, 0.05 dB (± 0.10), and the time does not differ measurably. It does not matter.",
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
            "train.scale=2: costs 3.00 dB (one seed), and the time does not differ measurably. Leave it."
        );
    }
}
