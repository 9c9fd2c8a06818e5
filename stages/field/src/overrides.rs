use std::collections::BTreeMap;

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
    /// The key. Empty if the fault is in several keys together.
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

#[cfg(test)]
mod tests {
    use super::*;
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
}
