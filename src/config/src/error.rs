use std::ops::Range;
use std::path::Path;

/// Where a key or value comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Origin {
    /// Bytes of pipeline.toml.
    Text(Range<usize>),
    /// A `--set` argument.
    Argument(String),
}

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

/// Counts from 1. Columns are in characters.
fn line_and_column(text: &str, offset: usize) -> (usize, usize) {
    let before = text.get(..offset.min(text.len())).unwrap_or(text);
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or("").chars().count() + 1;
    (line, column)
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
}
