//! pipeline.toml: as written (`low`), checked against the table of stages (`high`), and its JSON schema.
//!
//! Invariant: a key that no stage reads is refused, with the nearest name that one reads.

mod archives;
mod by_hand;
mod high;
mod low;
mod schema;
mod templates;

use std::path::{Path, PathBuf};

use marf_field::Device;

pub use high::{Node, Pipeline};
pub use low::Origin;
/// What may be asked of the network.
pub use marf_stage::Access;
pub use schema::schema;
pub use templates::{TEMPLATES, template};

/// A pipeline that cannot be run as written.
#[derive(Debug, Clone, PartialEq)]
pub struct ConfigError {
    /// Where.
    pub at: Origin,
    /// What, in one line.
    pub message: String,
    /// The way out, if known.
    pub hint: Option<String>,
}

impl ConfigError {
    pub(crate) fn at(at: Origin, message: String) -> Self {
        Self {
            at,
            message,
            hint: None,
        }
    }

    pub(crate) fn hint(mut self, hint: Option<String>) -> Self {
        self.hint = hint;
        self
    }

    /// Returns `file:line:column: message`, or the argument in its place.
    pub fn render(&self, file: &Path, text: &str) -> String {
        match &self.at {
            Origin::Argument(argument) => format!("--set {argument}: {}", self.message),
            Origin::Text(range) => {
                let (line, column) = line_and_column(text, range.start);
                format!("{}:{line}:{column}: {}", file.display(), self.message)
            }
        }
    }
}

/// Counts from 1; columns in characters.
fn line_and_column(text: &str, offset: usize) -> (usize, usize) {
    let before = text.get(..offset.min(text.len())).unwrap_or(text);
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or("").chars().count() + 1;
    (line, column)
}

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

/// What the command line says for all nodes and archives.
#[derive(Debug, Clone)]
pub struct Wishes {
    /// What nodes run on that can run on several devices and name none.
    pub device: Option<Device>,
    /// What may be asked of the network.
    pub access: Access,
}

/// Nothing is said: nodes choose their device, archives may be asked.
impl Default for Wishes {
    fn default() -> Self {
        Self {
            device: None,
            access: Access::Online,
        }
    }
}

/// Reads and checks a pipeline file, with `--set` arguments laid over it.
///
/// # Errors
/// A file that cannot be read, and everything [`ConfigError`] says.
pub fn load(file: &Path, sets: &[String], wishes: &Wishes) -> Result<Loaded, LoadError> {
    let text = std::fs::read_to_string(file).map_err(|error| LoadError {
        message: format!("{}: {error}", file.display()),
        hint: Some("write one with `marf init`, or name another with `--file`".to_owned()),
    })?;
    let base = file.parent().map(Path::to_path_buf).unwrap_or_default();
    let pipeline = check(&text, sets, wishes, &base).map_err(|error| LoadError {
        message: error.render(file, &text),
        hint: error.hint.clone(),
    })?;
    Ok(Loaded { pipeline, text })
}

/// Checks a pipeline's text; relative paths of archives are meant from `base`, where marf.lock lies too.
///
/// # Errors
/// The first thing that is wrong, with its place.
pub fn check(text: &str, sets: &[String], wishes: &Wishes, base: &Path) -> Result<Pipeline, ConfigError> {
    let mut root = low::parse(text)?;
    for argument in sets {
        low::set(&mut root, argument)?;
    }
    high::check(&root, wishes, &PathBuf::from(base))
}

/// Returns "did you mean `x`?" for the nearest of some names, if one is near.
fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<String> {
    let scored = known
        .into_iter()
        .map(|other| (strsim::damerau_levenshtein(name, other), other));
    let (distance, other) = scored.min_by_key(|(distance, _)| *distance)?;
    (distance <= 1 + name.len().max(other.len()) / 3).then(|| format!("did you mean `{other}`?"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_count_lines_and_characters_from_one() {
        assert_eq!(line_and_column("a\nbé = 1\n", 0), (1, 1));
        assert_eq!(line_and_column("a\nbé = 1\n", 5), (2, 3));
        assert_eq!(line_and_column("a", 99), (1, 2));
    }

    #[test]
    fn a_near_name_is_offered_and_a_far_one_is_not() {
        assert_eq!(
            nearest("min_byte", ["min_bytes", "input"]).as_deref(),
            Some("did you mean `min_bytes`?")
        );
        assert_eq!(nearest("zzzzzz", ["min_bytes", "input"]), None);
    }
}
