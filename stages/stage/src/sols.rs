//! Which sols are asked for: `1..=5`, `3`, `1,4,7..=9`, `latest`.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fmt::{Display, Formatter, Result as Written};

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};

/// Sols end before this one: 270 years.
const NO_SOL: u32 = 100_000;

/// A choice of sols.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Sols {
    /// All that are there, also photos of an unknown sol.
    All,
    /// The greatest existing sol.
    Latest,
    /// Inclusive ranges.
    Ranges(Vec<(u32, u32)>),
}

impl Sols {
    /// Reads a choice.
    ///
    /// # Errors
    /// Returns an error that names the part that is neither a sol nor a range.
    pub fn parse(text: &str) -> Result<Self, String> {
        if text.trim() == "latest" {
            return Ok(Self::Latest);
        }
        let ranges: Result<Vec<_>, String> = text.split(',').map(|part| range(part.trim())).collect();
        ranges.map(Self::Ranges)
    }

    /// Returns the first sol that another choice has too. `None` for choices that depend on the existing
    /// sols.
    pub fn shared_with(&self, other: &Self) -> Option<u32> {
        let (Self::Ranges(these), Self::Ranges(those)) = (self, other) else {
            return None;
        };
        let shared = these.iter().flat_map(|(first, last)| {
            let both = those
                .iter()
                .map(move |(from, to)| (*first.max(from), *last.min(to)));
            both.filter(|(first, last)| first <= last).map(|(first, _)| first)
        });
        shared.min()
    }

    /// Returns those of the present sols that are asked for.
    pub fn choose(&self, present: &BTreeSet<u32>) -> BTreeSet<u32> {
        match self {
            Self::All => present.clone(),
            Self::Latest => present.last().copied().into_iter().collect(),
            Self::Ranges(ranges) => {
                let wanted = |sol: &u32| ranges.iter().any(|(first, last)| (first..=last).contains(&sol));
                present.iter().copied().filter(wanted).collect()
            }
        }
    }
}

/// As [`Sols::parse`] reads it. `all` for all sols, which only the absence of a choice means.
impl Display for Sols {
    fn fmt(&self, to: &mut Formatter<'_>) -> Written {
        let text = |range: &(u32, u32)| {
            let (first, last) = range;
            if first == last {
                first.to_string()
            } else {
                format!("{first}..={last}")
            }
        };
        match self {
            Self::All => to.write_str("all"),
            Self::Latest => to.write_str("latest"),
            Self::Ranges(ranges) => to.write_str(&ranges.iter().map(text).collect::<Vec<_>>().join(",")),
        }
    }
}

impl Serialize for Sols {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// A text, or a bare number for one sol.
impl<'de> Deserialize<'de> for Sols {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged, expecting = "expected sols like \"1..=3\" or a number")]
        enum Either {
            Text(String),
            Number(u32),
        }
        match Either::deserialize(deserializer)? {
            Either::Text(text) => Self::parse(&text).map_err(D::Error::custom),
            Either::Number(sol) => Self::parse(&sol.to_string()).map_err(D::Error::custom),
        }
    }
}

impl JsonSchema for Sols {
    fn schema_name() -> Cow<'static, str> {
        "Sols".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({"type": ["string", "integer"], "minimum": 0})
    }
}

/// Reads one part of a choice: a sol or a range.
fn range(part: &str) -> Result<(u32, u32), String> {
    let sol = |text: &str| {
        let sol = text.trim().parse::<u32>().ok().filter(|sol| *sol < NO_SOL);
        sol.ok_or_else(|| {
            format!("`{part}` is not a sol or range: write `3`, `1..=5`, `1,4,7..=9` or `latest`")
        })
    };
    let (first, last) = if let Some((first, last)) = part.split_once("..=") {
        (sol(first)?, sol(last)?)
    } else if let Some((first, end)) = part.split_once("..") {
        let end = sol(end)?;
        (
            sol(first)?,
            end.checked_sub(1)
                .ok_or_else(|| format!("`{part}` is an empty range"))?,
        )
    } else {
        (sol(part)?, sol(part)?)
    };
    if first > last {
        return Err(format!("`{part}` is an empty range"));
    }
    Ok((first, last))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen(text: &str) -> Vec<u32> {
        let present = BTreeSet::from([0, 1, 2, 3, 7, 9, 12]);
        Sols::parse(text).unwrap().choose(&present).into_iter().collect()
    }

    #[test]
    fn a_choice_takes_what_is_there() {
        assert_eq!(chosen("3"), [3]);
        assert_eq!(chosen("1..=5"), [1, 2, 3]);
        assert_eq!(chosen("1..3"), [1, 2]);
        assert_eq!(chosen("1, 4, 7..=9"), [1, 7, 9]);
        assert_eq!(chosen("latest"), [12]);
        assert_eq!(chosen("500"), [] as [u32; 0]);
    }

    #[test]
    fn sols_of_two_choices_are_found() {
        let shared = |a: &str, b: &str| Sols::parse(a).unwrap().shared_with(&Sols::parse(b).unwrap());
        assert_eq!(shared("1..=5,9", "7,8"), None);
        assert_eq!(shared("1..=5,9", "9,4..=12"), Some(4));
        assert_eq!(shared("latest", "4"), None);
    }

    #[test]
    fn a_choice_is_written_as_it_is_read() {
        for text in ["3", "1..=5", "1,4,7..=9", "latest"] {
            assert_eq!(Sols::parse(text).unwrap().to_string(), text);
        }
        assert_eq!(Sols::parse(" 1..3 , 4").unwrap().to_string(), "1..=2,4");
    }

    #[test]
    fn what_is_no_range_is_named() {
        for bad in [
            "",
            "a",
            "1..=",
            "5..=1",
            "1..1",
            "0..0",
            "1,,2",
            "-1",
            "1.5",
            "100000",
            "4294967296",
            "..=3",
        ] {
            let error = Sols::parse(bad).unwrap_err();
            assert!(error.contains('`'), "{bad}: {error}");
        }
    }
}
