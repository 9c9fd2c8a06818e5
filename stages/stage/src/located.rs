//! JSON whose errors name the key they are at.

use serde::de::{
    DeserializeSeed, Deserializer, Error, Expected, IntoDeserializer, MapAccess, SeqAccess, Unexpected,
    Visitor,
    value::{MapAccessDeserializer, StrDeserializer},
};
use serde::forward_to_deserialize_any;
use serde_json::{Map, Value};

use crate::error::ParamError;

/// A value to deserialize. Messages are those of serde_json. Every type of parameters is compiled for this one deserializer alone.
pub(crate) struct LocatedJson(pub Value);

impl Error for ParamError {
    fn custom<T: std::fmt::Display>(message: T) -> Self {
        Self::new("", message.to_string())
    }

    fn invalid_type(found: Unexpected<'_>, expected: &dyn Expected) -> Self {
        Self::custom(serde_json::Error::invalid_type(found, expected))
    }

    fn invalid_value(found: Unexpected<'_>, expected: &dyn Expected) -> Self {
        Self::custom(serde_json::Error::invalid_value(found, expected))
    }
}

impl ParamError {
    /// Returns the error of a key as one of the table that holds it.
    fn in_table(mut self, key: &str) -> Self {
        let is_nested = !self.path.is_empty() && !self.path.starts_with('[');
        self.path = format!("{key}{}{}", if is_nested { "." } else { "" }, self.path);
        self
    }

    /// Returns the error of an element as one of the list that holds it.
    fn in_list(self, index: usize) -> Self {
        self.in_table(&format!("[{index}]"))
    }
}

impl<'de> Deserializer<'de> for LocatedJson {
    type Error = ParamError;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ParamError> {
        match self.0 {
            Value::Null => visitor.visit_unit(),
            Value::Bool(value) => visitor.visit_bool(value),
            Value::Number(value) => value.deserialize_any(visitor).map_err(ParamError::custom),
            Value::String(value) => visitor.visit_string(value),
            Value::Array(items) => {
                let mut items = Items::from(items);
                let value = visitor.visit_seq(&mut items)?;
                items.finish().map(|()| value)
            }
            Value::Object(table) => visitor.visit_map(Entries::from(table)),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ParamError> {
        match self.0 {
            Value::Null => visitor.visit_none(),
            _ => visitor.visit_some(self),
        }
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        visitor: V,
    ) -> Result<V::Value, ParamError> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &'static str,
        _variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, ParamError> {
        match self.0 {
            Value::String(variant) => visitor.visit_enum(variant.into_deserializer()),
            Value::Object(table) => visitor.visit_enum(MapAccessDeserializer::new(Entries::from(table))),
            other => Err(ParamError::invalid_type(unexpected(&other), &"string or map")),
        }
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf unit unit_struct seq tuple
        tuple_struct map struct identifier ignored_any
    }
}

/// Returns the name of a value in messages.
fn unexpected(value: &Value) -> Unexpected<'_> {
    match value {
        Value::Null => Unexpected::Unit,
        Value::Bool(value) => Unexpected::Bool(*value),
        Value::Number(value) => match (value.as_u64(), value.as_i64()) {
            (Some(value), _) => Unexpected::Unsigned(value),
            (None, Some(value)) => Unexpected::Signed(value),
            (None, None) => Unexpected::Float(value.as_f64().unwrap_or(f64::NAN)),
        },
        Value::String(value) => Unexpected::Str(value),
        Value::Array(_) => Unexpected::Seq,
        Value::Object(_) => Unexpected::Map,
    }
}

/// The elements of a list.
struct Items {
    rest: std::vec::IntoIter<Value>,
    length: usize,
}

impl From<Vec<Value>> for Items {
    fn from(items: Vec<Value>) -> Self {
        Self {
            length: items.len(),
            rest: items.into_iter(),
        }
    }
}

impl Items {
    fn finish(&self) -> Result<(), ParamError> {
        if self.rest.len() == 0 {
            return Ok(());
        }
        Err(ParamError::invalid_length(
            self.length,
            &"fewer elements in array",
        ))
    }
}

impl<'de> SeqAccess<'de> for &mut Items {
    type Error = ParamError;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, ParamError> {
        let Some(value) = self.rest.next() else {
            return Ok(None);
        };
        let index = self.length - self.rest.len() - 1;
        let read = seed.deserialize(LocatedJson(value));
        read.map(Some).map_err(|error| error.in_list(index))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.rest.len())
    }
}

/// The entries of a table.
struct Entries {
    rest: serde_json::map::IntoIter,
    key: String,
    value: Value,
}

impl From<Map<String, Value>> for Entries {
    fn from(table: Map<String, Value>) -> Self {
        Self {
            rest: table.into_iter(),
            key: String::new(),
            value: Value::Null,
        }
    }
}

impl Entries {
    /// Goes to the next entry; false behind the last one.
    fn advance(&mut self) -> bool {
        let Some((key, value)) = self.rest.next() else {
            return false;
        };
        (self.key, self.value) = (key, value);
        true
    }
}

impl<'de> MapAccess<'de> for Entries {
    type Error = ParamError;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, ParamError> {
        if !self.advance() {
            return Ok(None);
        }
        let key: StrDeserializer<'_, ParamError> = self.key.as_str().into_deserializer();
        let read = seed.deserialize(key);
        read.map(Some).map_err(|error| error.in_table(&self.key))
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, ParamError> {
        let read = seed.deserialize(LocatedJson(self.value.take()));
        read.map_err(|error| error.in_table(&self.key))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.rest.len())
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;
    use serde_json::json;

    use crate::from_json;

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, rename_all = "snake_case")]
    enum Shape {
        Point,
        Box { side: f64 },
    }

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Knobs {
        count: Option<u32>,
        shapes: Vec<Shape>,
        size: [f64; 2],
    }

    fn refusal(json: serde_json::Value) -> (String, String) {
        let error = from_json::<Knobs>(json).unwrap_err();
        (error.path, error.message)
    }

    #[test]
    fn a_table_is_read() {
        let table = json!({"count": null, "shapes": ["point", {"box": {"side": 2}}], "size": [1, 2.5]});
        let knobs = Knobs {
            count: None,
            shapes: vec![Shape::Point, Shape::Box { side: 2.0 }],
            size: [1.0, 2.5],
        };
        assert_eq!(from_json::<Knobs>(table), Ok(knobs));
    }

    #[test]
    fn an_error_has_the_path_of_its_key_and_the_message_of_serde_json() {
        let cases = [
            (
                json!({"cuont": 1}),
                "cuont",
                "unknown field `cuont`, expected one of `count`, `shapes`, `size`",
            ),
            (
                json!({"count": -1}),
                "count",
                "invalid value: integer `-1`, expected u32",
            ),
            (
                json!({"count": 1.5}),
                "count",
                "invalid type: floating point `1.5`, expected u32",
            ),
            (
                json!({"size": null}),
                "size",
                "invalid type: null, expected an array of length 2",
            ),
            (
                json!({"size": [1, true]}),
                "size[1]",
                "invalid type: boolean `true`, expected f64",
            ),
            (
                json!({"size": [1, 2, 3]}),
                "size",
                "invalid length 3, expected fewer elements in array",
            ),
            (
                json!({"shapes": ["dot"]}),
                "shapes[0]",
                "unknown variant `dot`, expected `point` or `box`",
            ),
            (
                json!({"shapes": [5]}),
                "shapes[0]",
                "invalid type: integer `5`, expected string or map",
            ),
            (
                json!({"shapes": [{"box": {"side": "a"}}]}),
                "shapes[0].box.side",
                "invalid type: string \"a\", expected f64",
            ),
            (json!({"count": 1}), "", "missing field `shapes`"),
        ];
        for (json, path, message) in cases {
            let theirs = serde_json::from_value::<Knobs>(json.clone()).unwrap_err();
            assert_eq!(theirs.to_string(), message);
            assert_eq!(refusal(json), (path.to_owned(), message.to_owned()));
        }
    }
}
