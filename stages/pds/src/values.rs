//! Numbers, tuples and words as labels write them.

use crate::label::{Sample, SampleKind};

/// Magnitudes from here on mean "unknown" (labels write 1.0e+30).
const SENTINEL: f64 = 1e29;

/// Reads a finite decimal number. `UNK`, `NULL`, `NaN`, infinities, 1e30 and anything else are `None`.
pub(crate) fn number(text: &str) -> Option<f64> {
    let value: f64 = text.trim().parse().ok()?;
    (value.is_finite() && value.abs() < SENTINEL).then_some(value)
}

/// Reads a special constant: a decimal number, or `16#FF7FFFFB#`, which for floating samples is their bits.
pub(crate) fn constant(text: &str, sample: Sample) -> Option<f64> {
    let Some((base, digits)) = text.trim().split_once('#') else {
        // Special constants may be sentinels: they only have to be finite.
        return text.trim().parse().ok().filter(|value: &f64| value.is_finite());
    };
    let base = base.parse().ok().filter(|base| (2..=36).contains(base))?;
    let bits = u64::from_str_radix(digits.strip_suffix('#')?, base).ok()?;
    let value = match (sample.kind, sample.bytes) {
        (SampleKind::Float, 4) => f64::from(f32::from_bits(u32::try_from(bits).ok()?)),
        (SampleKind::Float, _) => f64::from_bits(bits),
        (SampleKind::Signed, 2) => f64::from(u16::try_from(bits).ok()? as i16),
        (SampleKind::Signed, 4) => f64::from(u32::try_from(bits).ok()? as i32),
        _ => bits as f64,
    };
    Some(value).filter(|value| !value.is_nan())
}

/// Returns the number of bits up to the highest of a mask: of `2#0000111111111111#`, `16#FFF#` and `4095` 12.
pub(crate) fn mask_bits(mask: &str) -> Option<u32> {
    let mask = match mask.trim().split_once('#') {
        Some((base, digits)) => {
            let base = base.parse().ok().filter(|base| (2..=36).contains(base))?;
            u64::from_str_radix(digits.strip_suffix('#')?, base).ok()?
        }
        None => mask.trim().parse().ok()?,
    };
    let bits = u64::BITS - mask.leading_zeros();
    (1..=32).contains(&bits).then_some(bits)
}

/// Reads a whole number, also one written as `12.0`.
pub(crate) fn integer(text: &str) -> Option<i64> {
    let text = text.trim();
    text.parse().ok().or_else(|| {
        let value = number(text)?;
        (value.fract() == 0.0 && value.abs() < 9e15).then_some(value as i64)
    })
}

/// Reads a sol: 0 to 99,999.
pub fn sol(text: &str) -> Option<u32> {
    integer(text)
        .and_then(|value| u32::try_from(value).ok())
        .filter(|sol| *sol < 100_000)
}

/// Reads `(1,2,3)` of exactly `N` numbers.
pub(crate) fn tuple<const N: usize>(text: &str) -> Option<[f64; N]> {
    let inner = text.trim().strip_prefix('(')?.strip_suffix(')')?;
    let numbers: Option<Vec<f64>> = inner.split(',').take(N + 1).map(number).collect();
    numbers?.try_into().ok()
}

/// Returns the trimmed text. `None` if it means "no value" (`UNK`, `N/A` and the like).
pub fn known(text: &str) -> Option<String> {
    let text = text.trim();
    let unknown = ["", "UNK", "UNKNOWN", "NULL", "N/A", "NONE", "NONE AVAILABLE"];
    (!unknown.contains(&text.to_ascii_uppercase().as_str())).then(|| text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_that_are_no_number_are_refused() {
        for bad in [
            "UNK", "NULL", "", "NaN", "INF", "-inf", "1e999", "0x10", "1_5", "1.0e+30", "1,5", "1 2",
        ] {
            assert_eq!(number(bad), None, "{bad}");
        }
        assert_eq!(number(" -7.31905e-05 "), Some(-7.319_05e-5));
        assert_eq!(number("1e-999"), Some(0.0));
    }

    /// The constants of ISIS for 32-bit samples: NULL is FF7FFFFB, low saturation FF7FFFFC.
    #[test]
    fn a_constant_may_be_written_as_bits() {
        let of = |kind, bytes| Sample {
            kind,
            bytes,
            big_endian: true,
        };
        let float = constant("16#FF7FFFFB#", of(SampleKind::Float, 4)).unwrap();
        assert_eq!(float, f64::from(f32::from_bits(0xff7f_fffb)));
        assert_eq!(
            constant("-3.4028226550889045e+38", of(SampleKind::Float, 4)),
            Some(float)
        );
        assert_eq!(constant("16#8000#", of(SampleKind::Signed, 2)), Some(-32_768.0));
        assert_eq!(constant("16#FF#", of(SampleKind::Unsigned, 1)), Some(255.0));
        assert_eq!(constant("2#1111#", of(SampleKind::Unsigned, 2)), Some(15.0));
        assert_eq!(constant(" 0.0 ", of(SampleKind::Signed, 2)), Some(0.0));
        for bad in [
            "NULL",
            "16#",
            "16##",
            "99#1#",
            "1#1#",
            "16#GG#",
            "16#7FC00000#",
            "nan",
            "16#FFFFFFFFF#",
        ] {
            assert_eq!(constant(bad, of(SampleKind::Float, 4)), None, "{bad}");
        }
    }

    #[test]
    fn a_mask_gives_its_bits_in_every_base() {
        for (mask, bits) in [
            ("2#0000111111111111#", 12),
            ("2#11111111#", 8),
            ("16#0FFF#", 12),
            ("4095", 12),
            (" 2#1111111111110000# ", 16),
        ] {
            assert_eq!(mask_bits(mask), Some(bits), "{mask}");
        }
        for bad in [
            "",
            "2##",
            "16##",
            "2#0000#",
            "2#12#",
            "NULL",
            "0",
            "16#FFFFFFFFF#",
        ] {
            assert_eq!(mask_bits(bad), None, "{bad}");
        }
    }

    #[test]
    fn a_tuple_has_exactly_its_length() {
        assert_eq!(
            tuple::<3>("(2e-06,0.049535,-0.015973)"),
            Some([2e-6, 0.049_535, -0.015_973])
        );
        for bad in ["(1,2)", "(1,2,3,4)", "1,2,3", "(1,2,UNK)", "((1,2,3))"] {
            assert_eq!(tuple::<3>(bad), None, "{bad}");
        }
    }

    #[test]
    fn a_sol_is_small_and_whole() {
        assert_eq!(sol("709"), Some(709));
        assert_eq!(sol("12.0"), Some(12));
        for bad in ["-1", "1.5", "100000", "9e99", "UNK"] {
            assert_eq!(sol(bad), None, "{bad}");
        }
    }
}
