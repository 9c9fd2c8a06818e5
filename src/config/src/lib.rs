//! pipeline.toml: its syntax tree (`syntax`), checked against the tables of stages and archives (`resolve`,
//! `archives`), and its JSON schema.
//!
//! Invariant: a key that no stage reads is refused, with the nearest name that one reads.

mod archives;
mod error;
mod manual_lists;
pub mod nearest;
mod options;
mod place;
mod resolve;
pub mod scenes;
mod schema;
mod store;
mod syntax;
mod templates;
mod tuning;

use std::path::{Path, PathBuf};

pub use error::{ConfigError, Origin};
pub use manual_lists::entries as manual_entries;
use marf_cache::file::{FileKind, Links, read_text};
pub use options::GlobalOptions;
pub use resolve::{Node, Pipeline};
pub use schema::schema;
pub use store::SharedStore;
pub use templates::{TEMPLATES, template};

/// A pipeline together with the text it came from.
pub struct PipelineDocument {
    /// The checked pipeline.
    pub pipeline: Pipeline,
    /// The text of the file.
    pub text: String,
}

/// Why a pipeline could not be loaded, as text.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{message}")]
pub struct LoadError {
    /// Place and message in one line.
    pub message: String,
    /// What to do about it, if known.
    pub hint: Option<String>,
}

/// Reads and checks a pipeline file, with `--set` arguments applied to it.
///
/// # Errors
/// A file that cannot be read, and every [`ConfigError`].
pub fn load(file: &Path, sets: &[String], options: &GlobalOptions) -> Result<PipelineDocument, LoadError> {
    let text = read_text(file, FileKind::Settings, Links::Followed).map_err(|error| LoadError {
        message: format!("{}: {error}", file.display()),
        hint: Some("write one with `marf init`, or name another with `--file`".to_owned()),
    })?;
    let base = file.parent().map(Path::to_path_buf).unwrap_or_default();
    let pipeline = check(&text, sets, options, &base).map_err(|error| LoadError {
        message: error.render(file, &text),
        hint: error.hint.clone(),
    })?;
    Ok(PipelineDocument { pipeline, text })
}

/// Checks a pipeline's text. Paths of archives are relative to `base`, the folder of marf.lock.
///
/// # Errors
/// The first thing that is wrong, with its place.
pub fn check(
    text: &str,
    sets: &[String],
    options: &GlobalOptions,
    base: &Path,
) -> Result<Pipeline, ConfigError> {
    let mut root = syntax::parse(text)?;
    for argument in sets {
        syntax::set(&mut root, argument)?;
    }
    tuning::apply(&mut root)?;
    resolve::check(&root, options, &PathBuf::from(base))
}

/// Checks a pipeline that was kept as JSON ([`Pipeline::tree`]).
///
/// # Errors
/// Returns the first fault. Its place is not in any text.
pub fn check_tree(
    tree: &serde_json::Value,
    options: &GlobalOptions,
    base: &Path,
) -> Result<Pipeline, ConfigError> {
    resolve::check(&syntax::of_json(tree)?, options, &PathBuf::from(base))
}
