//! A value of a JSON file with its pointer, which every error names.

use serde_json::Value;

use super::cameras::ImportError;

/// A value and its JSON pointer.
#[derive(Clone)]
pub(super) struct JsonNode<'a> {
    pub file: &'a str,
    pub pointer: String,
    pub value: &'a Value,
}

impl<'a> JsonNode<'a> {
    /// Returns the whole document.
    pub fn root(file: &'a str, value: &'a Value) -> Self {
        let pointer = String::new();
        Self { file, pointer, value }
    }

    /// Returns an error at this value.
    pub fn error(&self, problem: impl Into<String>) -> ImportError {
        ImportError::new(self.file, &self.pointer, problem)
    }

    /// Returns the value of a key. `null` counts as absent.
    pub fn get(&self, key: &str) -> Option<Self> {
        let value = self.value.get(key).filter(|value| !value.is_null())?;
        Some(Self {
            file: self.file,
            pointer: format!("{}/{key}", self.pointer),
            value,
        })
    }

    /// Returns the value of a key that must be there.
    pub fn required(&self, key: &str) -> Result<Self, ImportError> {
        self.get(key)
            .ok_or_else(|| self.error(format!("`{key}` is missing")))
    }

    /// Returns the items of a list.
    pub fn items(&self) -> Result<Vec<Self>, ImportError> {
        let list = self.value.as_array().ok_or_else(|| self.error("not a list"))?;
        let item = |(index, value)| Self {
            file: self.file,
            pointer: format!("{}/{index}", self.pointer),
            value,
        };
        Ok(list.iter().enumerate().map(item).collect())
    }

    /// Returns a string.
    pub fn text(&self) -> Result<&'a str, ImportError> {
        self.value.as_str().ok_or_else(|| self.error("not a text"))
    }

    /// Returns a finite number.
    pub fn number(&self) -> Result<f64, ImportError> {
        let number = self.value.as_f64().filter(|number| number.is_finite());
        number.ok_or_else(|| self.error(format!("{} is not a finite number", short(self.value))))
    }

    /// Returns a boolean.
    pub fn truth(&self) -> Result<bool, ImportError> {
        self.value
            .as_bool()
            .ok_or_else(|| self.error("neither true nor false"))
    }
}

/// Returns the value as text of at most 40 characters.
fn short(value: &Value) -> String {
    let text = value.to_string();
    match text.char_indices().nth(40) {
        Some((cut, _)) => format!("{} …", &text[..cut]),
        None => text,
    }
}
