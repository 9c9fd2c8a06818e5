//! Numbers, times and counts as text.

/// Up to four significant digits, thousands with commas. Very small and very large numbers have an exponent.
pub(super) fn number(value: f64) -> String {
    let size = value.abs();
    if !value.is_finite() {
        return "not finite".to_owned();
    }
    if size == 0.0 {
        return "0".to_owned();
    }
    if !(1e-3..1e9).contains(&size) {
        return format!("{value:.2e}");
    }
    if value.fract() == 0.0 {
        return grouped(value);
    }
    let decimals = match size {
        size if size >= 1000.0 => 0,
        size if size >= 100.0 => 1,
        size if size >= 10.0 => 2,
        size if size >= 1.0 => 3,
        _ => 4,
    };
    if decimals == 0 {
        return grouped(value.round());
    }
    let text = format!("{value:.decimals$}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// A length with four significant digits, but none below a millionth of its unit: what rounding has left of 0 is 0.
pub(super) fn length(value: f64) -> String {
    number(if value.abs() < 1e-6 { 0.0 } else { value })
}

/// A number of a known kind: decibels have two decimals, so that columns of them line up.
pub(super) fn figure(key: &str, value: f64) -> String {
    let name = key.rsplit('.').next().unwrap_or(key);
    match name {
        _ if !value.is_finite() => number(value),
        "psnr" | "psnr_paper" | "psnr_members_mean" => decibels(value),
        "ssim" => similarity(value),
        _ => number(value),
    }
}

/// Decibels with two decimals.
pub(super) fn decibels(value: f64) -> String {
    format!("{value:.2}")
}

/// A structural similarity with three decimals.
pub(super) fn similarity(value: f64) -> String {
    format!("{value:.3}")
}

/// Milliseconds to hours, each with its unit.
pub(super) fn seconds(value: f64) -> String {
    match value {
        value if !value.is_finite() || value < 0.0 => "unknown".to_owned(),
        value if value < 0.001 => "< 1 ms".to_owned(),
        value if value < 1.0 => format!("{:.0} ms", value * 1e3),
        value if value < 10.0 => format!("{value:.1} s"),
        value if value < 120.0 => format!("{value:.0} s"),
        value if value < 7200.0 => format!("{} min {:02} s", value as u64 / 60, value as u64 % 60),
        value => format!("{} h {:02} min", value as u64 / 3600, value as u64 / 60 % 60),
    }
}

/// A count with its noun: `1 photo`, `2 photos`.
pub(super) fn count(count: usize, noun: &str) -> String {
    let ending = if count == 1 { "" } else { "s" };
    format!("{} {noun}{ending}", grouped(count as f64))
}

/// Megabytes with one decimal.
pub(super) fn megabytes(bytes: usize) -> String {
    format!("{:.1} MB", bytes as f64 / 1e6)
}

/// A coordinate of an SVG, a tenth of a pixel exact. 0 if it is not finite.
pub(super) fn px(value: f64) -> String {
    let value = if value.is_finite() {
        (value * 10.0).round() / 10.0
    } else {
        0.0
    };
    // -0 and 0 are one place.
    format!("{}", value + 0.0)
}

/// The first characters of a text, with an ellipsis where something was cut.
pub(super) fn cut(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    let start: String = text.chars().take(most.saturating_sub(1)).collect();
    format!("{start}…")
}

fn grouped(whole: f64) -> String {
    let digits = format!("{:.0}", whole.abs());
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    if whole < 0.0 { format!("-{text}") } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_four_digits_and_their_sign() {
        let cases = [
            (0.0, "0"),
            (-0.0, "0"),
            (12.0, "12"),
            (1234567.0, "1,234,567"),
            (-1234.0, "-1,234"),
            (1234.5, "1,235"),
            (27.318, "27.32"),
            (27.5, "27.5"),
            (99.999, "100"),
            (0.12345, "0.1235"),
            (1e-5, "1.00e-5"),
            (f64::NAN, "not finite"),
            (f64::NEG_INFINITY, "not finite"),
        ];
        for (value, text) in cases {
            assert_eq!(number(value), text, "{value}");
        }
    }

    #[test]
    fn a_length_that_rounding_has_left_of_nothing_is_nothing() {
        for (value, text) in [
            (7e-16, "0"),
            (-7e-16, "0"),
            (2e-6, "2.00e-6"),
            (0.25, "0.25"),
            (f64::NAN, "not finite"),
        ] {
            assert_eq!(length(value), text, "{value}");
        }
    }

    #[test]
    fn seconds_choose_their_unit() {
        let cases = [
            (0.0, "< 1 ms"),
            (0.25, "250 ms"),
            (9.94, "9.9 s"),
            (61.0, "61 s"),
            (125.0, "2 min 05 s"),
            (7322.0, "2 h 02 min"),
            (f64::NAN, "unknown"),
        ];
        for (value, text) in cases {
            assert_eq!(seconds(value), text, "{value}");
        }
    }

    #[test]
    fn a_place_that_is_not_finite_is_the_origin() {
        for (value, text) in [(f64::NAN, "0"), (-0.01, "0"), (1.26, "1.3"), (f64::INFINITY, "0")] {
            assert_eq!(px(value), text, "{value}");
        }
    }

    #[test]
    fn a_cut_text_counts_characters_and_not_bytes() {
        assert_eq!(cut("ünïcödé", 7), "ünïcödé");
        assert_eq!(cut("ünïcödé", 4), "ünï…");
    }
}
