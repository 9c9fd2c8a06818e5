//! The figures of a trade: effects with their intervals, and the front.

use marf_report::trade::{Effect, Interval, Point, PointRun, Trade};

/// Student's t for 95 %, two-sided, by degrees of freedom from 1 on (Abramowitz and Stegun, table 26.10). Beyond, the value of the normal
/// distribution is less than a tenth smaller.
const STUDENT: [f64; 12] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179,
];

/// Returns the trade of measured points. The first point is the unchanged pipeline.
pub fn figures(pipeline: &str, machine: &str, program: &str, points: Vec<Point>) -> Trade {
    Trade {
        pipeline: pipeline.to_owned(),
        machine: machine.to_owned(),
        program: program.to_owned(),
        effects: effects(&points),
        front: front(&points),
        points,
    }
}

/// Returns the effect of each point with one knob turned. A point without a seed in common with the base is left out.
fn effects(points: &[Point]) -> Vec<Effect> {
    let Some((base, others)) = points.split_first() else {
        return Vec::new();
    };
    let paired = |point: &Point, value: &dyn Fn(&PointRun, &PointRun) -> f64| -> Vec<f64> {
        let pairs = point.runs.iter().filter_map(|run| {
            let as_it_is = base.runs.iter().find(|base| base.seed == run.seed)?;
            Some(value(run, as_it_is))
        });
        pairs.collect()
    };
    let turned: Vec<(usize, &Point)> = others
        .iter()
        .enumerate()
        .filter(|(_, point)| point.sets.len() == 1 && point.is_comparable(base))
        .collect();
    let each = |value: &dyn Fn(&PointRun, &PointRun) -> f64| {
        let differences: Vec<Vec<f64>> = turned.iter().map(|(_, point)| paired(point, value)).collect();
        intervals(&differences)
    };
    let gains = each(&|run, base| run.psnr - base.psnr);
    let times = each(&|run, base| run.seconds / base.seconds);
    let both = turned.iter().zip(gains.into_iter().zip(times));
    both.map(|((index, _), (gain_db, time))| Effect {
        point: index + 1,
        gain_db,
        time,
    })
    .collect()
}

/// Returns the mean of each group with its interval at 95 %. The variance is that of all groups together, because a few seeds of one group
/// give a poor estimate.
fn intervals(groups: &[Vec<f64>]) -> Vec<Interval> {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let squares = |values: &Vec<f64>| {
        let mean = mean(values);
        values
            .iter()
            .map(|value| (value - mean) * (value - mean))
            .sum::<f64>()
    };
    let freedom: usize = groups.iter().map(|values| values.len().saturating_sub(1)).sum();
    let variance = groups.iter().map(squares).sum::<f64>() / freedom.max(1) as f64;
    let student = freedom
        .checked_sub(1)
        .map(|index| STUDENT.get(index).copied().unwrap_or(1.96));
    let interval = |values: &Vec<f64>| Interval {
        mean: mean(values),
        half: student.map(|student| student * (variance / values.len() as f64).sqrt()),
    };
    groups.iter().map(interval).collect()
}

/// Returns the Pareto front, the fastest first: no other point is as fast and better, or faster and as good.
fn front(points: &[Point]) -> Vec<usize> {
    let mut means: Vec<(usize, f64, f64)> = points
        .iter()
        .enumerate()
        .filter(|(_, point)| point.is_comparable(&points[0]))
        .filter_map(|(index, point)| point.means().map(|(psnr, seconds)| (index, psnr, seconds)))
        .collect();
    means.sort_by(|a, b| a.2.total_cmp(&b.2).then(b.1.total_cmp(&a.1)));
    let mut best = f64::NEG_INFINITY;
    means.retain(|(_, psnr, _)| {
        let is_better = *psnr > best;
        best = best.max(*psnr);
        is_better
    });
    means.into_iter().map(|(index, _, _)| index).collect()
}

/// Names of the columns of the table.
const COLUMNS: [&str; 14] = [
    "setting",
    "seed",
    "psnr_db",
    "ssim",
    "seconds",
    "calibrate_s",
    "train_s",
    "placed",
    "error_px",
    "steps",
    "parameters",
    "weights_bytes",
    "peak_mb",
    "fault",
];

/// Returns a row for every training and every point that could not be trained.
///
/// # Errors
/// None that a table in memory has.
pub fn csv(trade: &Trade) -> Result<Vec<u8>, csv::Error> {
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record(COLUMNS)?;
    for point in &trade.points {
        for run in &point.runs {
            table.write_record(row(&point.name(), run))?;
        }
        if let Some(fault) = &point.fault {
            let mut row = vec![String::new(); COLUMNS.len()];
            (row[0], row[COLUMNS.len() - 1]) = (point.name(), fault.clone());
            table.write_record(row)?;
        }
    }
    table.into_inner().map_err(|error| error.into_error().into())
}

fn row(name: &str, run: &PointRun) -> [String; 14] {
    let known = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
    [
        name.to_owned(),
        run.seed.to_string(),
        run.psnr.to_string(),
        known(run.ssim),
        run.seconds.to_string(),
        run.calibrate_s.to_string(),
        run.train_s.to_string(),
        run.placed.to_string(),
        known(run.error_px),
        run.steps.to_string(),
        run.parameters.to_string(),
        run.bytes.to_string(),
        run.peak_mb.to_string(),
        String::new(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(set: Option<&str>, runs: &[(f64, f64)]) -> Point {
        let run = |(seed, (psnr, seconds)): (usize, &(f64, f64))| PointRun {
            seed: seed as u64,
            judged_by: None,
            judged_scale: 4,
            psnr: *psnr,
            ssim: None,
            seconds: *seconds,
            calibrate_s: 0.0,
            train_s: *seconds,
            placed: 9,
            error_px: None,
            steps: 1,
            parameters: 1,
            bytes: 1,
            peak_mb: 0,
        };
        Point {
            sets: set.into_iter().map(str::to_owned).collect(),
            runs: runs.iter().enumerate().map(run).collect(),
            fault: None,
        }
    }

    /// Gains 1, 2 and 3 dB: mean 2, deviation 1, so that the interval is 4.303 / sqrt(3) to both sides.
    #[test]
    fn an_effect_is_paired_by_seed_and_has_students_interval() {
        let base = point(None, &[(20.0, 10.0), (21.0, 10.0), (22.0, 10.0)]);
        let turned = point(Some("train.steps=9"), &[(21.0, 5.0), (23.0, 5.0), (25.0, 5.0)]);
        let random = Point {
            sets: vec!["a=1".to_owned(), "b=2".to_owned()],
            ..turned.clone()
        };
        let trade = figures("p", "m", "marf", vec![base, turned, random]);
        let [effect] = trade.effects.as_slice() else {
            panic!("{:?}", trade.effects)
        };
        assert_eq!(
            (effect.point, effect.gain_db.mean, effect.time.mean),
            (1, 2.0, 0.5)
        );
        assert!((effect.gain_db.half.unwrap() - 4.303 / 3.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(effect.time.half, Some(0.0));
        let [alone] = intervals(&[vec![4.0]])[..] else {
            panic!("one group")
        };
        assert_eq!((alone.mean, alone.half), (4.0, None));
        // Variances 2 and 0 with a degree of freedom each: 1 in both.
        let pooled = intervals(&[vec![1.0, 3.0], vec![5.0, 5.0]]);
        let half = 4.303 / 2.0_f64.sqrt();
        assert!(
            pooled.iter().all(|of| (of.half.unwrap() - half).abs() < 1e-12),
            "{pooled:?}"
        );
        assert_eq!(intervals(&[]), []);
    }

    #[test]
    fn the_front_has_the_points_that_none_beats() {
        let failed = point(Some("e=1"), &[]);
        let points = [
            point(None, &[(20.0, 10.0)]),
            point(Some("a=1"), &[(19.0, 5.0)]),
            point(Some("b=1"), &[(18.5, 6.0)]),
            point(Some("c=1"), &[(20.0, 12.0)]),
            point(Some("d=1"), &[(21.0, 30.0)]),
            failed,
        ];
        assert_eq!(front(&points), [1, 0, 4]);
        assert_eq!(front(&[]), [0_usize; 0]);
    }

    #[test]
    fn the_table_has_a_row_for_every_training_and_every_fault() {
        let mut failed = point(Some("train.scale=\"x,y\""), &[]);
        failed.fault = Some("no \"x\"".to_owned());
        let trade = figures(
            "p",
            "m",
            "marf",
            vec![point(None, &[(20.5, 10.0), (20.0, 9.0)]), failed],
        );
        let table = String::from_utf8(csv(&trade).unwrap()).unwrap();
        let rows: Vec<&str> = table.lines().collect();
        assert_eq!(rows.len(), 4, "{table}");
        assert_eq!(rows[1], "as it is,0,20.5,,10,0,10,9,,1,1,1,0,");
        assert_eq!(
            rows[3],
            "\"train.scale=\"\"x,y\"\"\",,,,,,,,,,,,,\"no \"\"x\"\"\""
        );
        let columns = rows[0].split(',').count();
        assert_eq!(rows[1].split(',').count(), columns);
    }
}
