//! A number and the sentence that says what decided it.

use serde::{Deserialize, Serialize};

/// A number and what decided it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Choice<T> {
    /// The number.
    pub value: T,
    /// A sentence with the number that decided it.
    pub reason: String,
}

impl<T> Choice<T> {
    /// Returns a number and its reason.
    pub fn new(value: T, reason: impl Into<String>) -> Self {
        let reason = reason.into();
        Self { value, reason }
    }

    /// Returns a number that a key of the configuration sets.
    pub fn said(value: T, key: &str) -> Self {
        Self::new(value, format!("`{key}` says so"))
    }
}
