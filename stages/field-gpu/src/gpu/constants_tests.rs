//! Numbers that are in a kernel and in its twin on the CPU, compared as text: no adapter is needed.

use std::collections::BTreeSet;

use marf_numeric::GOLDEN;
use marf_shaders::{HARMONICS_OF, MATH, RNG};

use super::array::halves;

/// Returns the bits of all numbers in code that have a point or an exponent. Comments and names are left out.
fn floats(code: &str) -> BTreeSet<u32> {
    let lines = code
        .lines()
        .map(|line| line.split("//").next().unwrap_or_default());
    let mut found = BTreeSet::new();
    for line in lines {
        let line = line.replace('_', "").replace("e-", "e~").replace("f32", " ");
        for word in
            line.split(|letter: char| !letter.is_ascii_alphanumeric() && letter != '.' && letter != '~')
        {
            let word = word.replace('~', "-");
            let is_number = word.starts_with(|letter: char| letter.is_ascii_digit());
            let is_float = word.contains('.') || word.contains("e-");
            let word = word.trim_end_matches(['f', '.']);
            if let (true, Ok(number)) = (is_number && is_float, word.parse::<f32>()) {
                found.insert(number.to_bits());
            }
        }
    }
    found
}

/// Returns the code of a file without its tests.
fn code(file: &str) -> &str {
    file.split("#[cfg(test)]").next().unwrap_or_default()
}

#[test]
fn harmonics_have_the_coefficients_of_the_cpu() {
    let kernel = floats(HARMONICS_OF);
    let twin = floats(code(include_str!("../../../field/src/sh.rs")));
    assert!(twin.len() > 12, "{} coefficients", twin.len());
    assert_eq!(kernel, twin);
}

/// The kernel names ln 2's upper part by its integer and log2(e) by its digits. All else is in both.
#[test]
fn exponentials_have_the_coefficients_of_the_cpu() {
    let twin = floats(code(include_str!("../../../field/src/cpu/math.rs")));
    let own = [std::f32::consts::LOG2_E, 1.0 / 32768.0].map(f32::to_bits);
    let others = floats(MATH).into_iter().filter(|bits| !own.contains(bits));
    let missing: Vec<f32> = others
        .filter(|bits| !twin.contains(bits))
        .map(f32::from_bits)
        .collect();
    assert!(missing.is_empty(), "not in cpu/math.rs: {missing:?}");
    assert!(floats(MATH).contains(&own[0]) && floats(MATH).contains(&own[1]));
    assert_eq!(22713.0 / 32768.0_f32, 0.693_145_75);
}

#[test]
fn random_numbers_have_the_increment_of_the_cpu() {
    let [low, high] = halves(GOLDEN);
    let text = format!("const GOLDEN = vec2<u32>({low:#010x}u, {high:#010x}u);");
    assert!(RNG.contains(&text), "{text}");
}
