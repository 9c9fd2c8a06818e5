//! The single file of 0.1.0, which held the products of all archives.

use std::collections::BTreeMap;

use serde::Deserialize;
use toml::Spanned;

use super::text::{self, Line};
use super::{BadLine, SolPins, line_of};

const VERSION: i64 = 1;

/// What the file says of one archive.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct OldArchive {
    /// What the pipeline asked the archive for.
    pub asked: String,
    /// By sol.
    pub sols: BTreeMap<u32, SolPins>,
}

#[derive(Debug, Deserialize)]
struct File {
    #[serde(default)]
    archive: BTreeMap<String, Table>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    asked: String,
    #[serde(default)]
    products: Vec<Spanned<Line>>,
}

/// Reads the file, archive by archive.
///
/// # Errors
/// The first line that cannot be read, and why.
pub(super) fn read(text: &str) -> Result<BTreeMap<String, OldArchive>, BadLine> {
    text::check(text, VERSION)?;
    let file: File = toml::from_str(text).map_err(|error| text::bad(text, &error))?;
    let mut archives = BTreeMap::new();
    for (name, table) in file.archive {
        let mut archive = OldArchive {
            asked: table.asked,
            ..OldArchive::default()
        };
        for line in table.products {
            let start = line.span().start;
            let line = line.into_inner();
            let refuse = |cause: String| BadLine {
                line: line_of(text, start),
                cause,
            };
            let sol = line
                .sol
                .ok_or_else(|| refuse(format!("the line of `{}` names no sol", line.name)))?;
            line.add_to(archive.sols.entry(sol).or_default())
                .map_err(refuse)?;
        }
        archives.insert(name, archive);
    }
    Ok(archives)
}
