//! Numbers, times, sizes and counts as text: the only such module.

use std::collections::BTreeMap;

use marf_numeric::grouped;

/// Up to four significant digits, thousands with commas. Very small and very large numbers have an exponent.
pub fn number(value: f64) -> String {
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
        return grouped(format_args!("{value:.0}"));
    }
    let decimals = match size {
        size if size >= 1000.0 => 0,
        size if size >= 100.0 => 1,
        size if size >= 10.0 => 2,
        size if size >= 1.0 => 3,
        _ => 4,
    };
    if decimals == 0 {
        return grouped(format_args!("{:.0}", value.round()));
    }
    let text = format!("{value:.decimals$}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// A length with four significant digits, but none below a millionth of its unit: what rounding has left of 0 is 0.
pub fn length(value: f64) -> String {
    number(if value.abs() < 1e-6 { 0.0 } else { value })
}

/// Decibels with two decimals.
pub fn decibels(value: f64) -> String {
    format!("{value:.2}")
}

/// A structural similarity with three decimals.
pub fn similarity(value: f64) -> String {
    format!("{value:.3}")
}

/// Milliseconds to hours, each with its unit.
pub fn duration(seconds: f64) -> String {
    match seconds {
        value if !value.is_finite() || value < 0.0 => "unknown".to_owned(),
        value if value < 0.001 => "< 1 ms".to_owned(),
        value if value < 0.9995 => format!("{:.0} ms", value * 1e3),
        value if value < 9.95 => format!("{value:.1} s"),
        value if value < 119.5 => format!("{value:.0} s"),
        value => {
            let whole = value.round() as u64;
            match whole {
                0..7200 => format!("{} min {:02} s", whole / 60, whole % 60),
                _ => format!("{} h {:02} min", whole / 3600, whole / 60 % 60),
            }
        }
    }
}

/// A count with its noun: `1 photo`, `2 photos`.
pub fn count(count: usize, noun: &str) -> String {
    let ending = if count == 1 { "" } else { "s" };
    format!("{} {noun}{ending}", grouped(count))
}

/// A number of bytes in the unit that gives it one to three digits before the point (KB, MB, GB, TB: powers of 1000).
pub fn size(bytes: u64) -> String {
    if bytes < 1000 {
        return count(bytes as usize, "byte");
    }
    let (mut value, mut unit) = (bytes as f64 / 1e3, "KB");
    for larger in ["MB", "GB", "TB"] {
        // 999.95 and more would be printed as 1000.0.
        if value < 999.95 {
            break;
        }
        (value, unit) = (value / 1e3, larger);
    }
    format!("{value:.1} {unit}")
}

/// What a node did, by its counts: `kept 68 of 70 photos`, and how many it measured if it did not measure all.
pub fn node_counts(counts: &BTreeMap<String, u64>) -> Vec<String> {
    let number = |name: &str| counts.get(name).copied();
    let mut parts = Vec::new();
    if let (Some(kept), Some(rejected)) = (number("photos"), number("rejected")) {
        let all = kept + rejected;
        let photos = |photos: u64| count(photos as usize, "photo");
        match number("shards") {
            // A source meets files, and a file that is not a photo is rejected.
            Some(sols) => {
                parts.push(match sols {
                    0 | 1 => photos(kept),
                    sols => format!("{} of {}", photos(kept), count(sols as usize, "sol")),
                });
                parts
                    .extend((rejected > 0).then(|| format!("{} not read", count(rejected as usize, "file"))));
            }
            None => {
                parts.push(format!("kept {} of {}", grouped(kept), photos(all)));
                let again = number("measured").filter(|measured| (1..all).contains(measured));
                parts.extend(again.map(|measured| format!("measured {} of them", grouped(measured))));
            }
        }
    }
    parts.extend(number("children").map(|children| count(children as usize, "part")));
    parts
}

/// A coordinate of an SVG, a tenth of a pixel exact. 0 if it is not finite.
pub fn px(value: f64) -> String {
    let value = if value.is_finite() {
        (value * 10.0).round() / 10.0
    } else {
        0.0
    };
    // -0 and 0 are one place.
    format!("{}", value + 0.0)
}

/// The first characters of a text, with an ellipsis where something was cut.
pub fn cut(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    let start: String = text.chars().take(most.saturating_sub(1)).collect();
    format!("{start}…")
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
    fn durations_choose_their_unit() {
        let cases = [
            (0.0, "< 1 ms"),
            (0.25, "250 ms"),
            (0.9996, "1.0 s"),
            (9.94, "9.9 s"),
            (9.96, "10 s"),
            (61.0, "61 s"),
            (119.6, "2 min 00 s"),
            (125.0, "2 min 05 s"),
            (7199.6, "2 h 00 min"),
            (7322.0, "2 h 02 min"),
            (f64::NAN, "unknown"),
        ];
        for (value, text) in cases {
            assert_eq!(duration(value), text, "{value}");
        }
    }

    #[test]
    fn sizes_choose_their_unit_after_rounding() {
        for (bytes, text) in [
            (0, "0 bytes"),
            (1, "1 byte"),
            (999, "999 bytes"),
            (1_000, "1.0 KB"),
            (999_949, "999.9 KB"),
            (999_950, "1.0 MB"),
            (463_500_000, "463.5 MB"),
            (20_000_000_000, "20.0 GB"),
            (u64::MAX, "18446744.1 TB"),
        ] {
            assert_eq!(size(bytes), text);
        }
    }

    #[test]
    fn counts_of_a_node_have_their_total() {
        for (counts, text) in [
            (
                &[("photos", 68), ("rejected", 2), ("measured", 70), ("decided", 2)][..],
                "kept 68 of 70 photos",
            ),
            (
                &[("photos", 68), ("rejected", 2), ("measured", 2)],
                "kept 68 of 70 photos, measured 2 of them",
            ),
            (
                &[("photos", 1), ("rejected", 0), ("measured", 0), ("summarised", 2)],
                "kept 1 of 1 photo",
            ),
            (
                &[("photos", 70), ("rejected", 0), ("shards", 2), ("fetched", 1)],
                "70 photos of 2 sols",
            ),
            (
                &[("photos", 3), ("rejected", 1), ("shards", 1)],
                "3 photos, 1 file not read",
            ),
            (&[("children", 6)], "6 parts"),
            (&[], ""),
        ] {
            let counts = counts
                .iter()
                .map(|(name, count)| ((*name).to_owned(), *count))
                .collect();
            assert_eq!(node_counts(&counts).join(", "), text);
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
