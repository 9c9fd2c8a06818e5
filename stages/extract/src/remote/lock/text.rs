//! A sol as text: TOML with one product a line, so that a diff is a list of products.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use marf_cache::{Digest, Sha256};
use serde::{Deserialize, Serialize};
use toml::Spanned;

use super::{BadLine, Pin, SolPins, line_of};
use crate::net::Validators;

/// Version of the form.
pub(super) const VERSION: i64 = 2;

/// What of a product is in its line.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Line {
    name: String,
    #[serde(default)]
    bytes: Option<u64>,
    #[serde(default)]
    blake3: Option<String>,
    #[serde(default)]
    sha256: Option<Sha256>,
    #[serde(default)]
    url: Option<String>,
    #[serde(default)]
    fetched: Option<String>,
    #[serde(default)]
    etag: Option<String>,
    #[serde(default)]
    modified: Option<String>,
    #[serde(default)]
    listed: Option<String>,
    #[serde(default)]
    others: Vec<String>,
    #[serde(default)]
    left_out: Option<String>,
    #[serde(default)]
    status: Option<u16>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SolFile {
    #[serde(rename = "version")]
    _version: i64,
    sol: u32,
    #[serde(default)]
    complete: Option<String>,
    #[serde(default)]
    products: Vec<Spanned<Line>>,
}

/// Reads what [`write`] wrote of a sol.
///
/// # Errors
/// The first line that cannot be read, and why.
pub(crate) fn read(text: &str, sol: u32) -> Result<SolPins, BadLine> {
    check(text)?;
    let file: SolFile = toml::from_str(text).map_err(|error| bad(text, &error))?;
    if file.sol != sol {
        return Err(BadLine {
            line: line_starting(text, "sol"),
            cause: format!("it is of sol {}, its name says sol {sol}", file.sol),
        });
    }
    let mut pins = SolPins {
        complete: file.complete,
        ..SolPins::default()
    };
    let mut names = BTreeSet::new();
    for line in file.products {
        let start = line.span().start;
        let line = line.into_inner();
        let refuse = |cause: String| BadLine {
            line: line_of(text, start),
            cause,
        };
        if !names.insert(line.name.clone()) {
            return Err(refuse(format!("`{}` is there twice", line.name)));
        }
        line.add_to(&mut pins).map_err(refuse)?;
    }
    Ok(pins)
}

/// Returns the text of a sol, products sorted by name.
pub(crate) fn write(archive: &str, sol: u32, pins: &SolPins) -> String {
    let mut text = format!(
        "# Sol {sol} of archive {}, one product a line. Written by `marf run`; see the README.\nversion = {VERSION}\nsol = {sol}\n",
        quoted(archive)
    );
    if let Some(complete) = &pins.complete {
        // Writing into a string cannot fail.
        let _ = writeln!(text, "complete = {}", quoted(complete));
    }
    let mut lines: BTreeMap<(&str, u8), Vec<(&str, String)>> = BTreeMap::new();
    for (name, pin) in &pins.files {
        lines.insert((name, 0), pin.fields());
    }
    for (name, why) in &pins.left_out {
        lines.insert((name, 1), vec![("left_out", quoted(why))]);
    }
    for (name, status) in &pins.gone {
        lines.insert((name, 2), vec![("status", status.to_string())]);
    }
    text.push_str("products = [\n");
    for ((name, _), fields) in lines {
        let _ = write!(text, "  {{ name = {}", quoted(name));
        for (key, value) in fields {
            let _ = write!(text, ", {key} = {value}");
        }
        text.push_str(" },\n");
    }
    text.push_str("]\n");
    text
}

/// Returns a basic string of TOML, which has the same escapes as JSON.
pub(super) fn quoted(text: &str) -> String {
    serde_json::Value::from(text)
        .to_string()
        .replace('\u{7f}', "\\u007f")
}

/// Refuses the marks of a merge that was not resolved, and other versions.
///
/// # Errors
/// The line and its fault.
pub(super) fn check(text: &str) -> Result<(), BadLine> {
    let mark = |line: &str| {
        ["<<<<<<< ", ">>>>>>> ", "||||||| "]
            .iter()
            .any(|mark| line.starts_with(mark))
    };
    if let Some(index) = text.lines().position(mark) {
        return Err(BadLine {
            line: index + 1,
            cause: "two versions of the file were merged and the conflict is not resolved".to_owned(),
        });
    }
    // Only the version is read at first: a newer form may have keys that this program does not know.
    #[derive(Deserialize)]
    struct Version {
        version: i64,
    }
    let found: Version = toml::from_str(text).map_err(|error| bad(text, &error))?;
    if found.version == VERSION {
        return Ok(());
    }
    let cause = if found.version > VERSION {
        format!(
            "its version is {}: a newer marf wrote it, this one reads {VERSION}",
            found.version
        )
    } else {
        format!("its version is {}, not {VERSION}", found.version)
    };
    Err(BadLine {
        line: line_starting(text, "version"),
        cause,
    })
}

/// Locates an error of the TOML parser in a text.
pub(super) fn bad(text: &str, error: &toml::de::Error) -> BadLine {
    BadLine {
        line: line_of(text, error.span().map_or(0, |span| span.start)),
        cause: error.message().to_owned(),
    }
}

fn line_starting(text: &str, key: &str) -> usize {
    text.lines().position(|line| line.starts_with(key)).unwrap_or(0) + 1
}

impl Line {
    /// Adds the line to the pins of its sol.
    ///
    /// # Errors
    /// What of it is missing or no digest.
    fn add_to(self, pins: &mut SolPins) -> Result<(), String> {
        if let Some(why) = self.left_out {
            pins.left_out.insert(self.name, why);
        } else if let Some(status) = self.status {
            pins.gone.insert(self.name, status);
        } else {
            let name = self.name.clone();
            let pin = self
                .pin()
                .ok_or_else(|| format!("the line of `{name}` is not whole"))?;
            pins.files.insert(name, pin);
        }
        Ok(())
    }

    fn pin(self) -> Option<Pin> {
        let others: Option<BTreeSet<Digest>> = self.others.iter().map(|hex| hex.parse().ok()).collect();
        Some(Pin {
            bytes: self.bytes?,
            blake3: self.blake3?.parse().ok()?,
            sha256: self.sha256?,
            url: self.url?,
            fetched: self.fetched?,
            validators: Validators {
                etag: self.etag,
                modified: self.modified,
            },
            listed: self.listed,
            others: others?,
        })
    }
}

impl Pin {
    fn fields(&self) -> Vec<(&'static str, String)> {
        let mut fields = vec![
            ("bytes", self.bytes.to_string()),
            ("blake3", quoted(&self.blake3.to_string())),
            ("sha256", quoted(&self.sha256.to_string())),
            ("url", quoted(&self.url)),
            ("fetched", quoted(&self.fetched)),
        ];
        let optional = [
            ("etag", &self.validators.etag),
            ("modified", &self.validators.modified),
            ("listed", &self.listed),
        ];
        for (key, value) in optional {
            fields.extend(value.as_ref().map(|value| (key, quoted(value))));
        }
        if !self.others.is_empty() {
            let others = self.others.iter().map(|other| quoted(&other.to_string()));
            fields.push(("others", format!("[{}]", others.collect::<Vec<_>>().join(", "))));
        }
        fields
    }
}
