//! Whole numbers as people read them.

use std::fmt::Display;

/// Returns a whole number with its digits in groups of three: `1,234,567`, `-1,234`.
pub fn grouped(whole: impl Display) -> String {
    let number = whole.to_string();
    let digits = number.trim_start_matches('-');
    let mut text = number[..number.len() - digits.len()].to_owned();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_stand_in_threes_behind_the_sign() {
        let cases = [
            "0",
            "12",
            "123",
            "1,234",
            "-123",
            "-1,234",
            "123,456",
            "1,234,567",
        ];
        for text in cases {
            assert_eq!(grouped(text.replace(',', "")), text);
        }
        assert_eq!(grouped(u64::MAX), "18,446,744,073,709,551,615");
        assert_eq!(grouped(format_args!("{:.0}", 1234.5_f64)), "1,234");
    }
}
