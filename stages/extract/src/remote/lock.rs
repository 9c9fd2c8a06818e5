//! marf.lock: what each network archive gave, to the byte.
//!
//! Users keep it under version control: one line a product, so that a diff is a list of products. The tables of other
//! archives are kept as they are.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::Path;

use marf_cache::Digest;
use marf_stage::StageError;
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};

use crate::files;
use crate::net::Validators;

/// In the place of an address: the bytes came with the page that listed them (the record of a feed).
pub(crate) const WITH_LISTING: &str = "with the listing";
/// Version of the format; another is refused.
const VERSION: i64 = 1;
/// Largest lock that is read: two million products.
const MAX_BYTES: u64 = 1 << 30;

/// The pins of one archive.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Pins {
    /// What the pipeline asked the archive for: kind, mission, camera and the like.
    pub asked: String,
    /// By sol.
    pub sols: BTreeMap<u32, SolPins>,
}

/// The pins of one sol.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct SolPins {
    /// Files that were fetched, by name.
    pub files: BTreeMap<String, Pin>,
    /// Files that were not wanted, by name, and why.
    pub left_out: BTreeMap<String, String>,
    /// Files that were listed and could not be fetched, by name: the last status.
    pub gone: BTreeMap<String, u16>,
}

/// A file as it was fetched.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Pin {
    /// Length, bytes.
    pub bytes: u64,
    /// Digest of the bytes.
    pub blake3: Digest,
    /// The address that gave it.
    pub url: String,
    /// The time, as `YYYY-MM-DDTHH:MM:SSZ`.
    pub fetched: String,
    /// What the server says of this state of the file.
    pub validators: Validators,
    /// When the listing said it was last changed.
    pub listed: Option<String>,
    /// Other bytes that the archive gave under the same name later: kept, not used.
    pub others: BTreeSet<Digest>,
}

/// One line of the file.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Line {
    sol: u32,
    name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    bytes: Option<u64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    blake3: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    url: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    fetched: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    etag: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    modified: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    listed: Option<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    others: Vec<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    left_out: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    status: Option<u16>,
}

#[derive(Debug, Deserialize)]
struct File {
    version: i64,
    #[serde(default)]
    archive: BTreeMap<String, Table>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    asked: String,
    #[serde(default)]
    products: Vec<Line>,
}

/// Reads what the lock file says of one archive; nothing, where there is no file.
///
/// # Errors
/// A file that cannot be read or is no lock, with the place.
pub(crate) fn read(path: &Path, archive: &str) -> Result<Pins, StageError> {
    let Some(text) = text(path)? else {
        return Ok(Pins::default());
    };
    let refuse = |cause: String| {
        StageError::new(format!(
            "`{}` is no lock file that this version reads",
            path.display()
        ))
        .cause(cause)
        .hint("restore it from version control, or delete it: everything it named is then fetched anew")
    };
    let file: File = toml::from_str(&text).map_err(|error| refuse(error.to_string()))?;
    if file.version != VERSION {
        return Err(refuse(format!("its version is {}, not {VERSION}", file.version)));
    }
    let Some((_, table)) = file.archive.into_iter().find(|(name, _)| name == archive) else {
        return Ok(Pins::default());
    };
    let mut pins = Pins {
        asked: table.asked,
        ..Pins::default()
    };
    for line in table.products {
        let name = line.name.clone();
        pins.add(line)
            .ok_or_else(|| refuse(format!("the line of `{name}` is not whole")))?;
    }
    Ok(pins)
}

/// Replaces what the lock file says of one archive. Nothing is written where nothing changes.
///
/// # Errors
/// A file that cannot be written.
pub(crate) fn write(path: &Path, archive: &str, pins: &Pins) -> Result<(), StageError> {
    // Several archives of one pipeline share the file.
    static WRITING: Mutex<()> = Mutex::new(());
    let _writing = WRITING.lock();
    let old = text(path)?.unwrap_or_default();
    let new = with_table(&old, archive, &pins.table(archive));
    if new == old {
        return Ok(());
    }
    let fail = |error: std::io::Error| {
        StageError::new(format!("`{}` cannot be written", path.display())).cause(error.to_string())
    };
    files::replace_durably(path, new.as_bytes()).map_err(fail)
}

fn text(path: &Path) -> Result<Option<String>, StageError> {
    let fail = |cause: String| StageError::new(format!("`{}` cannot be read", path.display())).cause(cause);
    match std::fs::metadata(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(fail(error.to_string())),
        Ok(meta) if meta.len() > MAX_BYTES => return Err(fail(format!("it has {} bytes", meta.len()))),
        Ok(_) => {}
    }
    std::fs::read_to_string(path)
        .map(Some)
        .map_err(|error| fail(error.to_string()))
}

/// Returns the file with one archive's table replaced; tables in the order of their names.
fn with_table(old: &str, archive: &str, table: &str) -> String {
    let mut tables: BTreeMap<String, String> = BTreeMap::new();
    let mut current = None;
    for line in old.lines() {
        if let Some(name) = line
            .strip_prefix("[archive.")
            .and_then(|rest| rest.strip_suffix(']'))
        {
            current = Some(name.to_owned());
        }
        if let Some(name) = &current {
            let kept = tables.entry(name.clone()).or_default();
            kept.push_str(line);
            kept.push('\n');
        }
    }
    tables.insert(key(archive), table.to_owned());
    let head = format!(
        "# Written by `marf run`: what each archive gave, to the byte. Keep it under version control; `marf run --locked` \
         takes exactly this.\nversion = {VERSION}\n"
    );
    tables
        .into_values()
        .fold(head, |file, table| format!("{file}\n{}\n", table.trim_end()))
}

/// Returns a key of TOML, bare where it may be.
fn key(name: &str) -> String {
    let bare = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-';
    if !name.is_empty() && name.bytes().all(bare) {
        name.to_owned()
    } else {
        quoted(name)
    }
}

/// Returns a basic string of TOML; what JSON escapes, TOML reads the same way.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text)
        .to_string()
        .replace('\u{7f}', "\\u007f")
}

impl Pins {
    fn add(&mut self, line: Line) -> Option<()> {
        let sol = self.sols.entry(line.sol).or_default();
        if let Some(why) = line.left_out {
            sol.left_out.insert(line.name, why);
        } else if let Some(status) = line.status {
            sol.gone.insert(line.name, status);
        } else {
            let others: Option<BTreeSet<Digest>> = line.others.iter().map(|hex| hex.parse().ok()).collect();
            let pin = Pin {
                bytes: line.bytes?,
                blake3: line.blake3?.parse().ok()?,
                url: line.url?,
                fetched: line.fetched?,
                validators: Validators {
                    etag: line.etag,
                    modified: line.modified,
                },
                listed: line.listed,
                others: others?,
            };
            sol.files.insert(line.name, pin);
        }
        Some(())
    }

    fn table(&self, archive: &str) -> String {
        let mut table = format!(
            "[archive.{}]\nasked = {}\nproducts = [\n",
            key(archive),
            quoted(&self.asked)
        );
        for (sol, pins) in &self.sols {
            for (name, pin) in &pins.files {
                pin.write(&mut table, *sol, name);
            }
            for (name, why) in &pins.left_out {
                line(&mut table, *sol, name, &[("left_out", quoted(why))]);
            }
            for (name, status) in &pins.gone {
                line(&mut table, *sol, name, &[("status", status.to_string())]);
            }
        }
        table.push_str("]\n");
        table
    }
}

impl Pin {
    fn write(&self, table: &mut String, sol: u32, name: &str) {
        let mut fields = vec![
            ("bytes", self.bytes.to_string()),
            ("blake3", quoted(&self.blake3.to_string())),
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
            let others: Vec<String> = self
                .others
                .iter()
                .map(|other| quoted(&other.to_string()))
                .collect();
            fields.push(("others", format!("[{}]", others.join(", "))));
        }
        line(table, sol, name, &fields);
    }
}

fn line(table: &mut String, sol: u32, name: &str, fields: &[(&str, String)]) {
    // Writing into a string cannot fail.
    let _ = write!(table, "  {{ sol = {sol}, name = {}", quoted(name));
    for (key, value) in fields {
        let _ = write!(table, ", {key} = {value}");
    }
    table.push_str(" },\n");
}

#[cfg(test)]
mod tests;
