use super::error::CliError;

/// Longest training a budget may ask for: a day.
const LONGEST_S: f64 = 86_400.0;

/// Reads `10s`, `5m`, `1h` or `90` as whole seconds.
///
/// # Errors
/// Names a text that is no time, or out of 1 s to 24 h.
pub fn seconds(text: &str) -> Result<u32, CliError> {
    let text = text.trim();
    let unit = text
        .find(|char: char| char.is_ascii_alphabetic())
        .unwrap_or(text.len());
    let scale = match &text[unit..] {
        "" | "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3_600.0,
        _ => return Err(refuse(text)),
    };
    let value: f64 = text[..unit].trim().parse().map_err(|_| refuse(text))?;
    let seconds = (value * scale).round();
    if (1.0..=LONGEST_S).contains(&seconds) {
        Ok(seconds as u32)
    } else {
        Err(refuse(text))
    }
}

fn refuse(text: &str) -> CliError {
    CliError::usage(format!(
        "`{text}` is no budget: write 10s, 5m or 1h, from 1 s to 24 h"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budgets_are_read_in_seconds_minutes_and_hours() {
        for (text, expected) in [
            ("10s", 10),
            ("60", 60),
            ("5m", 300),
            ("1.5m", 90),
            ("1h", 3600),
            (" 10 s", 10),
        ] {
            assert_eq!(seconds(text), Ok(expected), "{text}");
        }
    }

    #[test]
    fn what_is_no_budget_is_refused() {
        for text in ["", "s", "-1s", "0s", "25h", "10x", "nan", "inf", "1e9s"] {
            assert!(seconds(text).is_err(), "{text}");
        }
    }
}
