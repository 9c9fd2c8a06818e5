//! Units of physical values as labels spell them.

/// Spectral radiance of 1 W / (m2 sr nm) in W / (m3 sr).
const PER_NANOMETRE: f64 = 1e9;

/// What a unit measures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Unit {
    /// Spectral radiance: so many W / (m2 sr nm).
    Radiance(f64),
    /// I/F: radiance over that of a white surface under the sun.
    Reflectance,
}

/// A symbol: its name in upper case, its dimension, and its size in SI units.
const SYMBOLS: [(&str, Dimension, f64); 24] = [
    ("W", Dimension::Power, 1.0),
    ("WATT", Dimension::Power, 1.0),
    ("WATTS", Dimension::Power, 1.0),
    ("MW", Dimension::Power, 1e-3),
    ("MILLIWATT", Dimension::Power, 1e-3),
    ("UW", Dimension::Power, 1e-6),
    ("MICROWATT", Dimension::Power, 1e-6),
    ("M", Dimension::Length, 1.0),
    ("METER", Dimension::Length, 1.0),
    ("METRE", Dimension::Length, 1.0),
    ("CM", Dimension::Length, 1e-2),
    ("MM", Dimension::Length, 1e-3),
    ("UM", Dimension::Length, 1e-6),
    ("MICRON", Dimension::Length, 1e-6),
    ("MICRONS", Dimension::Length, 1e-6),
    ("MICROMETER", Dimension::Length, 1e-6),
    ("NM", Dimension::Length, 1e-9),
    ("NANOMETER", Dimension::Length, 1e-9),
    ("NANOMETERS", Dimension::Length, 1e-9),
    ("A", Dimension::Length, 1e-10),
    ("ANGSTROM", Dimension::Length, 1e-10),
    ("SR", Dimension::Angle, 1.0),
    ("STER", Dimension::Angle, 1.0),
    ("STERADIAN", Dimension::Angle, 1.0),
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Dimension {
    Power,
    Length,
    Angle,
}

/// Reads a unit in any spelling: `W/m**2/sr/nm`, `WATT*M**-2*SR**-1*NM**-1`, `W.m^-2.sr^-1.um^-1`, `uW/(cm2 sr nm)`, `I/F`.
/// `None` if it measures something else or is not read.
pub(crate) fn read(text: &str) -> Option<Unit> {
    let upper = text
        .trim()
        .to_uppercase()
        .replace(['\u{b5}', '\u{3bc}', '\u{39c}'], "U");
    if ["I/F", "IOF", "I OVER F"].contains(&upper.as_str()) {
        return Some(Unit::Reflectance);
    }
    let mut powers = [0; 3];
    let mut size = 1.0;
    for (symbol, power) in factors(&upper)? {
        let (_, dimension, unit) = SYMBOLS.iter().find(|(name, ..)| *name == symbol)?;
        powers[*dimension as usize] += power;
        size *= unit.powi(power);
    }
    (powers == [1, -3, -1]).then_some(Unit::Radiance(size / PER_NANOMETRE))
}

/// Returns the symbols of a product and their powers. `None` for other text.
fn factors(text: &str) -> Option<Vec<(&str, i32)>> {
    let mut found = Vec::new();
    let (mut sign, mut group, mut rest) = (1, 1, text);
    while let Some(first) = rest.chars().next() {
        if first.is_alphabetic() {
            let end = rest
                .find(|next: char| !next.is_alphabetic())
                .unwrap_or(rest.len());
            let (symbol, after) = rest.split_at(end);
            let (power, after) = power(after)?;
            found.push((symbol, power * sign * group));
            (sign, rest) = (1, after);
            continue;
        }
        match first {
            '/' => sign = -1,
            '(' => (group, sign) = (sign, 1),
            ')' => group = 1,
            '*' | '.' | '·' | '-' | '_' => {}
            _ if first.is_whitespace() => {}
            _ => return None,
        }
        rest = &rest[first.len_utf8()..];
    }
    Some(found)
}

/// Reads the power behind a symbol: `**-2`, `^2`, `-1`, `2`, or nothing, which is 1. Returns it with the remaining text.
fn power(text: &str) -> Option<(i32, &str)> {
    let marked = text.strip_prefix("**").or_else(|| text.strip_prefix('^'));
    let digits = marked.unwrap_or(text);
    let signed = digits.strip_prefix('-');
    let plain = signed.unwrap_or(digits);
    let end = plain
        .find(|next: char| !next.is_ascii_digit())
        .unwrap_or(plain.len());
    if end == 0 {
        return marked.is_none().then_some((1, text));
    }
    let number: i32 = plain[..end].parse().ok().filter(|number| *number <= 9)?;
    Some((if signed.is_some() { -number } else { number }, &plain[end..]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Spellings of JPL's programs, of labels of MER, MSL and Mars 2020, and of the PDS4 dictionary.
    #[test]
    fn radiance_is_read_in_every_spelling() {
        for (text, size) in [
            ("W/M**2/SR/NM", 1.0),
            ("W/M**2/NM/SR", 1.0),
            ("WATT*M**-2*SR**-1*NM**-1", 1.0),
            ("W.m**-2.sr**-1.nm**-1", 1.0),
            ("W m^-2 sr^-1 nm^-1", 1.0),
            ("W m-2 nm-1 sr-1", 1.0),
            ("W/m2/sr/nm", 1.0),
            ("W/(m2 sr nm)", 1.0),
            ("watts/(meter**2 * steradian * nanometer)", 1.0),
            ("W/m**2/sr/um", 1e-3),
            ("W/(m**2*steradian*micron)", 1e-3),
            ("W*m**-2*sr**-1*µm**-1", 1e-3),
            ("uW/cm^2/sr/nm", 1e-2),
            ("mW.cm**-2.sr**-1.um**-1", 1e-2),
        ] {
            let Some(Unit::Radiance(read)) = read(text) else {
                panic!("{text} is not read");
            };
            assert!((read / size - 1.0).abs() < 1e-12, "{text}: {read}, not {size}");
        }
        for text in ["I/F", "i/f", "IOF"] {
            assert_eq!(read(text), Some(Unit::Reflectance), "{text}");
        }
    }

    #[test]
    fn other_units_are_not_taken_for_radiance() {
        for text in [
            "",
            "DN",
            "DN/S",
            "W/M**2/SR",
            "W/M**2/NM",
            "W",
            "W/M**2/SR/NM / DN/S",
            "W/m**/sr/nm",
            "W/m2/sr/nm2",
            "m",
            "<>",
            "W/m99/sr/nm",
            "ph/m2/sr/nm",
            "1",
            "pixel",
        ] {
            assert_eq!(read(text), None, "{text}");
        }
    }
}
