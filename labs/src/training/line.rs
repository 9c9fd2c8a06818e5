//! The result of a training against the clock: a line of JSON a budget, and a table of all.

use std::fmt;

use marf_cache::Digest;
use marf_field::EXPECTED_STEPS_PER_S;
use serde::{Serialize, Serializer};

use crate::output::decimal;

/// How long a training goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Budget {
    /// By the clock.
    Seconds(u32),
    /// By its steps.
    Steps(u64),
}

impl Budget {
    /// Returns the steps it is expected to have.
    pub fn expected_steps(self) -> u64 {
        match self {
            Self::Seconds(seconds) => (f64::from(seconds) * EXPECTED_STEPS_PER_S) as u64,
            Self::Steps(steps) => steps,
        }
    }
}

impl fmt::Display for Budget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Seconds(seconds) => write!(f, "{seconds}s"),
            Self::Steps(steps) => write!(f, "{steps}steps"),
        }
    }
}

impl Serialize for Budget {
    /// Seconds are a number, as the comparison wants them.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Seconds(seconds) => serializer.serialize_u32(*seconds),
            Self::Steps(_) => serializer.collect_str(self),
        }
    }
}

/// One budget's line.
#[derive(Debug, Serialize)]
pub struct Line {
    /// The requested budget.
    pub budget: Budget,
    /// Seconds trained.
    pub clock: f64,
    /// Seconds of the budget spent before, to find the number of steps in the time, and the best batch for a GPU.
    pub paced_s: f64,
    /// Processor seconds of these.
    pub cpu_s: f64,
    pub steps: u64,
    /// Samples that a step aimed at.
    pub batch_samples: u32,
    /// Binary logarithm of the most entries of a level.
    pub log2_table: u32,
    /// Digest of the training's whole state at its end: on one device the same for the same steps.
    pub checkpoint: Digest,
    pub rays_per_s: f64,
    pub samples_per_s: f64,
    /// Largest resident size so far, MB.
    pub rss_mb: u64,
    /// Mean over the test views, peak 1, at most 100 dB a view.
    pub psnr: f64,
    /// Mean of the paper's definition over the views that are not black.
    pub psnr_paper: Option<f64>,
    /// Mean over the views of at least 11 pixels a side.
    pub ssim: Option<f64>,
    /// Seconds that one test view took to render.
    pub render_s: f64,
    /// Rays a second of this.
    pub render_rays_per_s: f64,
}

/// The budgets as the paper's Table 1 has them.
pub fn table(lines: &[Line]) -> String {
    let mut rows = vec![format!(
        "{:>8} {:>9} {:>12} {:>7} {:>8} {:>10}",
        "budget", "PSNR dB", "paper's dB", "SSIM", "steps", "Msamples/s"
    )];
    rows.extend(lines.iter().map(|line| {
        format!(
            "{:>8} {:>9.2} {:>12} {:>7} {:>8} {:>10.2}",
            line.budget.to_string(),
            line.psnr,
            decimal(line.psnr_paper, 2),
            decimal(line.ssim, 3),
            line.steps,
            line.samples_per_s / 1e6
        )
    }));
    rows.push("peak 1, at most 100 dB a view. The paper's peak is the photo's largest value".to_owned());
    rows.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_has_a_row_a_budget_and_a_dash_for_what_is_not_known() {
        let line = Line {
            budget: Budget::Seconds(10),
            clock: 10.1,
            paced_s: 0.0,
            cpu_s: 20.0,
            steps: 123,
            batch_samples: 1 << 15,
            log2_table: 15,
            checkpoint: Digest::from_content(b"state"),
            rays_per_s: 1e5,
            samples_per_s: 3.21e6,
            rss_mb: 100,
            psnr: 18.456,
            psnr_paper: Some(17.0),
            ssim: None,
            render_s: 0.4,
            render_rays_per_s: 4e5,
        };
        let table = table(&[line]);
        let row: Vec<&str> = table.lines().nth(1).unwrap().split_whitespace().collect();
        assert_eq!(row, ["10s", "18.46", "17.00", "-", "123", "3.21"]);
    }
}
