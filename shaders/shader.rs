//! A kernel's text, and the constants that all begin with.

use crate::structs::{counts, faults};

/// A kernel's text.
#[derive(Debug, Clone, Copy)]
pub struct Shader {
    /// Its name.
    pub name: &'static str,
    /// What it shares with others, in order, before its own text.
    pub shared: &'static [&'static str],
    /// Its own text.
    pub text: &'static str,
    /// Heads it is tested with.
    pub heads: &'static [&'static str],
}

impl Shader {
    /// Returns the whole text, which begins with [`constants`]. `head` holds the constants that decide its
    /// shape.
    pub fn source(&self, head: &str) -> String {
        let mut text = constants();
        text.push_str(head);
        for part in self.shared.iter().chain([&self.text]) {
            text.push('\n');
            text.push_str(part);
        }
        text
    }
}

/// Rows of the array `found` of the kernel `compare`.
pub mod found {
    /// Slopes in the three log gains.
    pub const GAIN: usize = 0;
    /// Slopes in the three offsets.
    pub const OFFSET: usize = 3;
    /// Sum of squared errors.
    pub const LOSS: usize = 6;
    /// Slopes in the three channels of the ray's colour.
    pub const SLOPE: usize = 7;
    /// Slope times colour behind.
    pub const TOWARDS: usize = 10;
    /// Rows.
    pub const LEN: usize = 11;
}

/// Returns the places in the arrays `counts`, `faults` and `found` as constants of WGSL.
pub fn constants() -> String {
    let places = [
        ("COUNT_VISITED", counts::VISITED),
        ("COUNT_KEPT", counts::KEPT),
        ("COUNT_RAYS", counts::RAYS),
        ("COUNT_ALIVE", counts::ALIVE),
        ("FAULT_DENSITY", faults::DENSITY),
        ("FAULT_LOGITS", faults::LOGITS),
        ("FAULT_LOSS", faults::LOSS),
        ("FAULT_FEATURES", faults::FEATURES),
        ("FAULT_NETWORKS", faults::NETWORKS),
        ("FAULT_BACKGROUND", faults::BACKGROUND),
        ("FAULT_EXPOSURES", faults::EXPOSURES),
        ("FAULT_SLOTS", faults::LEN as u32),
        ("FOUND_GAIN", found::GAIN as u32),
        ("FOUND_OFFSET", found::OFFSET as u32),
        ("FOUND_LOSS", found::LOSS as u32),
        ("FOUND_SLOPE", found::SLOPE as u32),
        ("FOUND_TOWARDS", found::TOWARDS as u32),
        ("FOUND_ROWS", found::LEN as u32),
    ];
    let lines = places.map(|(name, place)| format!("const {name}: u32 = {place}u;\n"));
    lines.concat()
}
