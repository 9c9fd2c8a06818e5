use std::collections::BTreeMap;

use marf_cache::{ContentHash, Visitor};
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::Config;

/// Some keys of [`Config`], to be laid over defaults: what a person or a search has chosen, and nothing else.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Overrides(pub BTreeMap<String, Value>);

/// A key that [`Config`] does not have, or a value it cannot take.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct OverrideError {
    /// The key; empty where the fault is of several keys together.
    pub key: String,
    /// What is wrong, with the number.
    pub message: String,
}

impl Overrides {
    /// Returns these keys laid over `base`.
    ///
    /// # Errors
    /// Names the first key that is unknown, of another type or out of its range.
    pub fn over(&self, base: &Config) -> Result<Config, OverrideError> {
        let mut config = base.clone();
        for (key, value) in &self.0 {
            config = with_key(&config, key, value)?;
        }
        config.check().map_err(|error| OverrideError {
            key: String::new(),
            message: error.to_string(),
        })?;
        Ok(config)
    }

    /// Returns these keys with `above` laid over them.
    #[must_use]
    pub fn with(&self, above: &Self) -> Self {
        let mut all = self.0.clone();
        all.extend(above.0.iter().map(|(key, value)| (key.clone(), value.clone())));
        Self(all)
    }
}

fn with_key(config: &Config, key: &str, value: &Value) -> Result<Config, OverrideError> {
    let fail = |error: serde_json::Error| OverrideError {
        key: key.to_owned(),
        message: error.to_string(),
    };
    let mut table = serde_json::to_value(config).map_err(fail)?;
    if let Value::Object(table) = &mut table {
        table.insert(key.to_owned(), value.clone());
    }
    serde_json::from_value(table).map_err(fail)
}

impl JsonSchema for Overrides {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        Config::schema_name()
    }

    /// Returns the schema of [`Config`], none of whose keys is required.
    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        Config::json_schema(generator)
    }
}

impl ContentHash for Overrides {
    fn walk(&self, visitor: &mut dyn Visitor) {
        walk_table(self.0.iter(), self.0.len(), visitor);
    }
}

fn walk_table<'a>(
    entries: impl Iterator<Item = (&'a String, &'a Value)>,
    count: usize,
    visitor: &mut dyn Visitor,
) {
    visitor.open("table", count);
    for (key, value) in entries {
        visitor.field(key);
        walk_value(value, visitor);
    }
    visitor.close();
}

/// Walks JSON by content: a whole number is the same however it was written.
fn walk_value(value: &Value, visitor: &mut dyn Visitor) {
    match value {
        Value::Null => visitor.text("null"),
        Value::Bool(value) => visitor.truth(*value),
        Value::String(value) => visitor.text(value),
        Value::Number(number) => match (number.as_u64(), number.as_i64()) {
            (Some(value), _) => visitor.unsigned(value),
            (None, Some(value)) => visitor.signed(value),
            // Without arbitrary precision every other number is an f64.
            (None, None) => visitor.float(number.as_f64().unwrap_or(f64::NAN)),
        },
        Value::Array(values) => {
            visitor.sequence(values.len() as u64);
            values.iter().for_each(|value| walk_value(value, visitor));
            visitor.close();
        }
        Value::Object(table) => {
            // Sorted, whichever order the map keeps.
            let sorted: BTreeMap<&String, &Value> = table.iter().collect();
            let count = sorted.len();
            walk_table(sorted.into_iter(), count, visitor);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_cache::digest_of;
    use serde_json::json;

    fn table(value: Value) -> Overrides {
        serde_json::from_value(value).unwrap()
    }

    #[test]
    fn named_keys_are_set_and_the_others_keep_their_value() {
        let config = table(json!({"levels": 16, "features": 2, "learning_rate": 0.004}))
            .over(&Config::default())
            .unwrap();
        assert_eq!(
            (config.levels, config.features, config.learning_rate),
            (Some(16), 2, 0.004)
        );
        assert_eq!(config.log2_table, Config::default().log2_table);
    }

    #[test]
    fn an_unknown_key_a_wrong_type_and_a_number_out_of_range_are_named() {
        for (keys, word) in [
            (json!({"lerning_rate": 0.1}), "lerning_rate"),
            (json!({"levels": "many"}), "many"),
            (json!({"log2_table": 99}), "log2_table"),
            (json!({"levels": -1}), "-1"),
        ] {
            let error = table(keys).over(&Config::default()).unwrap_err();
            assert!(error.to_string().contains(word), "{word}: {error}");
        }
    }

    #[test]
    fn what_lies_above_wins() {
        let both = table(json!({"levels": 4, "cone": 0.1})).with(&table(json!({"levels": 16})));
        assert_eq!(both, table(json!({"levels": 16, "cone": 0.1})));
    }

    #[test]
    fn every_key_and_value_is_content() {
        let digests: Vec<_> = [
            json!({}),
            json!({"levels": 4}),
            json!({"levels": 16}),
            json!({"features": 4}),
            json!({"levels": 4.5}),
            json!({"levels": "4"}),
            json!({"levels": [4]}),
        ]
        .into_iter()
        .map(|keys| digest_of(&table(keys)))
        .collect();
        for (index, digest) in digests.iter().enumerate() {
            assert!(!digests[..index].contains(digest), "{index}");
        }
    }
}
