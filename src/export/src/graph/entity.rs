//! Entities: JSON objects with `@id` and `@type`.

use serde_json::{Map, Value, json};

use crate::contents::is_plain;

/// What the parameters of tools conform to.
pub(super) const FORMAL_PARAMETER: &str = "https://bioschemas.org/profiles/FormalParameter/1.0-RELEASE";
/// The program.
pub(super) const PROGRAM: &str = "#marf";
/// The language of pipelines.
pub(super) const LANGUAGE: &str = "#marf/pipeline";

/// An entity that is being made.
pub(super) struct Entity(Map<String, Value>);

impl Entity {
    /// Begins an entity of one type.
    pub(super) fn new(id: impl Into<String>, kind: &str) -> Self {
        let mut fields = Map::new();
        fields.insert("@id".to_owned(), Value::from(id.into()));
        fields.insert("@type".to_owned(), Value::from(kind));
        Self(fields)
    }

    /// Adds a field, or replaces it. An unknown value leaves it out.
    pub(super) fn with(mut self, name: &str, value: impl Into<Value>) -> Self {
        let value = value.into();
        if !value.is_null() {
            self.0.insert(name.to_owned(), value);
        }
        self
    }

    /// Adds references. Without any the field is left out, and a single one is not a list.
    pub(super) fn with_ids<S: Into<String>>(self, name: &str, ids: impl IntoIterator<Item = S>) -> Self {
        let mut ids: Vec<Value> = ids.into_iter().map(|id| reference(id)).collect();
        match ids.len() {
            0 => self,
            1 => self.with(name, ids.remove(0)),
            _ => self.with(name, ids),
        }
    }

    pub(super) fn into_value(self) -> Value {
        Value::Object(self.0)
    }
}

fn reference(id: impl Into<String>) -> Value {
    json!({"@id": id.into()})
}

/// Returns the id of an entity about something with this name: `#kind/name`, with a digest if the name is not
/// a URI.
pub(super) fn id_of(kind: &str, name: &str) -> String {
    if is_plain(name) {
        format!("#{kind}/{name}")
    } else {
        format!(
            "#{kind}/blake3-{}",
            marf_cache::Digest::from_content(name.as_bytes())
        )
    }
}

/// Returns the ids that a field refers to.
pub(crate) fn ids(value: &Value) -> Vec<&str> {
    match value {
        Value::Array(values) => values.iter().flat_map(ids).collect(),
        Value::Object(fields) => fields.get("@id").and_then(Value::as_str).into_iter().collect(),
        _ => Vec::new(),
    }
}

/// Returns all references of an entity: the field and the id it refers to.
pub(crate) fn references(entity: &Value) -> Vec<(&str, &str)> {
    let fields = entity.as_object().into_iter().flatten();
    let of_field = |(name, value)| ids(value).into_iter().map(move |id| (String::as_str(name), id));
    fields.flat_map(of_field).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_reference_is_no_list_and_none_is_no_field() {
        let entity = Entity::new("#a", "X")
            .with_ids("none", Vec::<String>::new())
            .with_ids("one", ["#b"])
            .with_ids("two", ["#b", "#c"])
            .into_value();
        assert_eq!(
            entity,
            json!({"@id": "#a", "@type": "X", "one": {"@id": "#b"}, "two": [{"@id": "#b"}, {"@id": "#c"}]})
        );
        assert_eq!(references(&entity), [("one", "#b"), ("two", "#b"), ("two", "#c")]);
    }

    #[test]
    fn a_name_that_is_no_uri_is_replaced_by_its_digest() {
        assert_eq!(id_of("action", "tune/trial-00"), "#action/tune/trial-00");
        for odd in ["a b", "ä", "../x", "a\"b", ""] {
            let id = id_of("action", odd);
            assert!(id.starts_with("#action/blake3-"), "{id}");
        }
    }
}
