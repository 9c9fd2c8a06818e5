//! Training times as a user writes them.

use marf_schema::train::Budget;

use crate::error::Error;

/// Longest training a budget may ask for: a day.
const LONGEST_S: f64 = 86_400.0;

/// Reads a training time (`10s`, `5m`, `1h`) as whole seconds. A number without a unit is seconds.
///
/// # Errors
/// A text that is not a time, or a time not within 1 s to 24 h.
pub fn whole_seconds(text: &str) -> Result<u32, Error> {
    let refuse = || {
        Error::usage(format!(
            "`{text}` is not a budget: write 10s, 5m or 1h, from 1 s to 24 h"
        ))
    };
    let unit = if text.trim_end().ends_with(|last: char| last.is_ascii_digit()) {
        "s"
    } else {
        ""
    };
    let budget: Budget = format!("{text}{unit}").parse().map_err(|_| refuse())?;
    let seconds = budget.seconds().round();
    if (1.0..=LONGEST_S).contains(&seconds) {
        Ok(seconds as u32)
    } else {
        Err(refuse())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budgets_are_read_in_seconds_minutes_and_hours() {
        for (text, expected) in [
            ("10s", 10),
            ("60", 60),
            (" 60 ", 60),
            ("5m", 300),
            ("1.5m", 90),
            ("1h", 3600),
            (" 10 s", 10),
        ] {
            assert_eq!(whole_seconds(text), Ok(expected), "{text}");
        }
    }

    #[test]
    fn what_is_no_budget_is_refused() {
        for text in ["", "s", "-1s", "0s", "25h", "10x", "nan", "inf", "1e9s"] {
            assert!(whole_seconds(text).is_err(), "{text}");
        }
        let said = format!("{:?}", whole_seconds("25h"));
        assert!(said.contains("from 1 s to 24 h"), "{said}");
        assert_eq!((whole_seconds("1s"), whole_seconds("24h")), (Ok(1), Ok(86_400)));
    }
}
