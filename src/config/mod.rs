//! pipeline.toml: as written (`low`), checked against the table of stages (`high`), and its JSON schema.
//!
//! Invariant: a key that no stage reads is refused, with the nearest name that one reads.

mod archives;
mod by_hand;
mod error;
mod high;
mod low;
mod options;
mod schema;
mod templates;

use std::path::{Path, PathBuf};

pub use error::{ConfigError, Origin};
pub use high::{Node, Pipeline};
pub use options::GlobalOptions;
pub use schema::schema;
pub use templates::{TEMPLATES, template};

/// A pipeline together with the text it came from.
pub struct Loaded {
    /// The checked pipeline.
    pub pipeline: Pipeline,
    /// The text of the file.
    pub text: String,
}

/// Why a pipeline could not be loaded, ready for people.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{message}")]
pub struct LoadError {
    /// Place and complaint in one line.
    pub message: String,
    /// The way out, if known.
    pub hint: Option<String>,
}

/// Reads and checks a pipeline file, with `--set` arguments laid over it.
///
/// # Errors
/// A file that cannot be read, and everything [`ConfigError`] says.
pub fn load(file: &Path, sets: &[String], options: &GlobalOptions) -> Result<Loaded, LoadError> {
    let text = std::fs::read_to_string(file).map_err(|error| LoadError {
        message: format!("{}: {error}", file.display()),
        hint: Some("write one with `marf init`, or name another with `--file`".to_owned()),
    })?;
    let base = file.parent().map(Path::to_path_buf).unwrap_or_default();
    let pipeline = check(&text, sets, options, &base).map_err(|error| LoadError {
        message: error.render(file, &text),
        hint: error.hint.clone(),
    })?;
    Ok(Loaded { pipeline, text })
}

/// Checks a pipeline's text; relative paths of archives are meant from `base`, where marf.lock lies too.
///
/// # Errors
/// The first thing that is wrong, with its place.
pub fn check(
    text: &str,
    sets: &[String],
    options: &GlobalOptions,
    base: &Path,
) -> Result<Pipeline, ConfigError> {
    let mut root = low::parse(text)?;
    for argument in sets {
        low::set(&mut root, argument)?;
    }
    high::check(&root, options, &PathBuf::from(base))
}
