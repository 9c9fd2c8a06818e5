use std::{fmt, str::FromStr};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Memory that a training may take, written as `2GB` or `800MB`: whole megabytes of 10^6 bytes.
// An absolute number instead of a share of the machine's memory, as it decides which pixels of the photos
// are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String", extend("pattern" = "^[0-9.]+ *(MB|GB)$"))]
pub struct Memory {
    megabytes: u64,
}

impl Default for Memory {
    fn default() -> Self {
        Self { megabytes: 4_000 }
    }
}

impl Memory {
    /// Returns the bytes.
    pub fn bytes(self) -> u64 {
        self.megabytes * 1_000_000
    }
}

impl FromStr for Memory {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let fail =
            || format!("`{text}` is not an amount of memory: write `2GB` or `800MB`, from 1MB to 1000000GB");
        let trimmed = text.trim();
        let scaled = |unit: &str, scale: f64| Some((trimmed.strip_suffix(unit)?, scale));
        let (number, scale) = scaled("GB", 1e3).or_else(|| scaled("MB", 1.0)).ok_or_else(fail)?;
        let megabytes = number.trim().parse::<f64>().map_err(|_| fail())? * scale + 0.5;
        if !(1.0..=1e9).contains(&megabytes) {
            return Err(fail());
        }
        Ok(Self {
            megabytes: megabytes as u64,
        })
    }
}

impl fmt::Display for Memory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.megabytes.is_multiple_of(1000) {
            write!(f, "{}GB", self.megabytes / 1000)
        } else {
            write!(f, "{}MB", self.megabytes)
        }
    }
}

impl TryFrom<String> for Memory {
    type Error = String;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl From<Memory> for String {
    fn from(memory: Memory) -> Self {
        memory.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_reads_its_units_and_prints_them() {
        for (text, printed, bytes) in [
            ("2GB", "2GB", 2_000_000_000),
            (" 1.5 GB", "1500MB", 1_500_000_000),
            ("800MB", "800MB", 800_000_000),
            ("1000 MB", "1GB", 1_000_000_000),
        ] {
            let memory: Memory = text.parse().unwrap();
            assert_eq!(
                (memory.to_string().as_str(), memory.bytes()),
                (printed, bytes),
                "{text}"
            );
            assert_eq!(memory.to_string().parse::<Memory>(), Ok(memory));
        }
        for text in [
            "", "2", "GB", "-1GB", "0MB", "2TB", "nanGB", "infGB", "9e9GB", "2 gigs",
        ] {
            let error = text.parse::<Memory>().unwrap_err();
            assert!(
                error.contains(&format!("`{text}`")) && error.contains("`2GB`"),
                "{error}"
            );
        }
    }
}
