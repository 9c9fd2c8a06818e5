use std::{fmt, str::FromStr, time::Duration};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Training time, written as `60s`, `5m`, `1.5h` or `800ms`: whole milliseconds, above zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String", extend("pattern" = "^[0-9.]+ *(ms|s|m|min|h)$"))]
pub struct Budget {
    milliseconds: u64,
}

impl Budget {
    /// Longest budget, a thousand hours.
    const MAX_MS: f64 = 3.6e9;

    /// Returns the time in seconds.
    pub fn seconds(self) -> f64 {
        self.milliseconds as f64 / 1000.0
    }

    /// Returns the time.
    pub fn duration(self) -> Duration {
        Duration::from_millis(self.milliseconds)
    }
}

impl FromStr for Budget {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let fail = || format!("`{text}` is not a time: write `60s`, `5m`, `1h` or `800ms`");
        let trimmed = text.trim();
        let unit_at = trimmed
            .find(|letter: char| !(letter.is_ascii_digit() || letter == '.'))
            .ok_or_else(fail)?;
        let (number, unit) = trimmed.split_at(unit_at);
        let unit_ms = match unit.trim() {
            "ms" => 1.0,
            "s" => 1e3,
            "m" | "min" => 6e4,
            "h" => 3.6e6,
            _ => return Err(fail()),
        };
        let milliseconds = number.parse::<f64>().map_err(|_| fail())? * unit_ms + 0.5;
        if !(1.0..=Self::MAX_MS).contains(&milliseconds) {
            return Err(fail());
        }
        Ok(Self {
            milliseconds: milliseconds as u64,
        })
    }
}

impl fmt::Display for Budget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.milliseconds.is_multiple_of(1000) {
            write!(f, "{}s", self.milliseconds / 1000)
        } else {
            write!(f, "{}ms", self.milliseconds)
        }
    }
}

impl TryFrom<String> for Budget {
    type Error = String;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl From<Budget> for String {
    fn from(budget: Budget) -> Self {
        budget.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_reads_its_units_and_prints_seconds() {
        for (text, printed, seconds) in [
            ("60s", "60s", 60.0),
            ("5m", "300s", 300.0),
            (" 1.5 h ", "5400s", 5400.0),
            ("800ms", "800ms", 0.8),
            ("0.25s", "250ms", 0.25),
            ("2min", "120s", 120.0),
        ] {
            let budget: Budget = text.parse().unwrap();
            assert_eq!(
                (budget.to_string().as_str(), budget.seconds()),
                (printed, seconds),
                "{text}"
            );
            assert_eq!(budget.to_string().parse::<Budget>(), Ok(budget));
        }
    }

    #[test]
    fn what_is_no_time_is_refused_with_the_way_to_write_it() {
        for text in [
            "",
            "60",
            "s",
            "-5s",
            "0s",
            "1e9s",
            "5 parsecs",
            "..s",
            "99999999h",
            "NaNs",
        ] {
            let error = text.parse::<Budget>().unwrap_err();
            assert!(
                error.contains(&format!("`{text}`")) && error.contains("`60s`"),
                "{error}"
            );
        }
    }
}
