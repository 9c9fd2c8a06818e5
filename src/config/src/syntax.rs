//! The syntax tree of pipeline.toml: values with their places.

use std::ops::Range;

use serde_json::{Map, Number, Value as Json};
use toml::de::{DeTable, DeValue};

use super::error::{ConfigError, Origin};
use crate::nearest::did_you_mean;

/// A value and its place.
#[derive(Debug, Clone, PartialEq)]
pub struct SyntaxNode {
    /// Where it stands.
    pub at: Origin,
    /// The value itself.
    pub value: Value,
}

/// A TOML value. Dates do not occur in a pipeline.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// In the order of the file.
    Table(Vec<Entry>),
    /// In order.
    Array(Vec<SyntaxNode>),
    /// A string.
    Text(String),
    /// Any integer of 64 bits, signed or not.
    Integer(i128),
    /// A finite float.
    Float(f64),
    /// `true` or `false`.
    Truth(bool),
}

/// A key with its value.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// The key.
    pub key: String,
    /// Where the key stands.
    pub at: Origin,
    /// Its value.
    pub value: SyntaxNode,
}

/// Reads a TOML text.
///
/// # Errors
/// Syntax errors, dates, and numbers that are not finite or do not fit 64 bits, with their place.
pub fn parse(text: &str) -> Result<SyntaxNode, ConfigError> {
    let table = DeTable::parse(text).map_err(|error| {
        ConfigError::at(
            Origin::Text(error.span().unwrap_or(0..0)),
            error.message().to_owned(),
        )
    })?;
    syntax_node(table.span(), &DeValue::Table(table.into_inner()))
}

fn syntax_node(span: Range<usize>, value: &DeValue<'_>) -> Result<SyntaxNode, ConfigError> {
    let at = Origin::Text(span);
    let refuse = |message: String| ConfigError::at(at.clone(), message);
    let value = match value {
        DeValue::String(text) => Value::Text(text.to_string()),
        DeValue::Boolean(truth) => Value::Truth(*truth),
        DeValue::Integer(integer) => Value::Integer(
            i128::from_str_radix(integer.as_str(), integer.radix())
                .ok()
                .filter(|value| i64::try_from(*value).is_ok() || u64::try_from(*value).is_ok())
                .ok_or_else(|| refuse(format!("`{integer}` does not fit 64 bits")))?,
        ),
        DeValue::Float(float) => Value::Float(
            float
                .as_str()
                .parse::<f64>()
                .ok()
                .filter(|value| value.is_finite())
                .ok_or_else(|| refuse(format!("`{float}` is not a finite number")))?,
        ),
        DeValue::Datetime(_) => return Err(refuse("a date has no meaning here".to_owned())),
        DeValue::Array(items) => Value::Array(
            items
                .iter()
                .map(|item| syntax_node(item.span(), item.get_ref()))
                .collect::<Result<_, _>>()?,
        ),
        DeValue::Table(table) => Value::Table(
            table
                .iter()
                .map(|(key, value)| {
                    let (name, at) = (key.get_ref().to_string(), Origin::Text(key.span()));
                    Ok(Entry {
                        key: name,
                        at,
                        value: syntax_node(value.span(), value.get_ref())?,
                    })
                })
                .collect::<Result<_, ConfigError>>()?,
        ),
    };
    Ok(SyntaxNode { at, value })
}

/// Returns a tree of the values of JSON. Its places are not in any text.
///
/// # Errors
/// `null`, which no pipeline holds.
pub fn of_json(json: &Json) -> Result<SyntaxNode, ConfigError> {
    let at = || Origin::Text(0..0);
    let value = match json {
        Json::Null => {
            return Err(ConfigError::at(
                at(),
                "`null` is not allowed in a pipeline".to_owned(),
            ));
        }
        Json::Bool(truth) => Value::Truth(*truth),
        Json::String(text) => Value::Text(text.clone()),
        Json::Number(number) => {
            let whole = number
                .as_i64()
                .map(i128::from)
                .or(number.as_u64().map(i128::from));
            whole.map_or_else(
                || Value::Float(number.as_f64().unwrap_or(f64::NAN)),
                Value::Integer,
            )
        }
        Json::Array(items) => Value::Array(items.iter().map(of_json).collect::<Result<_, _>>()?),
        Json::Object(table) => {
            let entry = |(key, value): (&String, &Json)| {
                Ok(Entry {
                    key: key.clone(),
                    at: at(),
                    value: of_json(value)?,
                })
            };
            Value::Table(table.iter().map(entry).collect::<Result<_, ConfigError>>()?)
        }
    };
    Ok(SyntaxNode { at: at(), value })
}

/// Applies one `--set path.to.key=value`. The value is TOML, or a plain string if it is not valid TOML.
///
/// # Errors
/// An argument without `=`, a node or archive that the file does not have, or a path through something that is not a table.
pub fn set(root: &mut SyntaxNode, argument: &str) -> Result<(), ConfigError> {
    let origin = Origin::Argument(argument.to_owned());
    let Some((path, text)) = argument.split_once('=') else {
        return Err(ConfigError::at(origin, "write it as node.key=value".to_owned()));
    };
    let mut parts: Vec<&str> = path.trim().split('.').collect();
    let is_top = matches!(parts[0], "node" | "archive" | "name" | "keep" | "reject") || parts == ["tune"];
    if !is_top {
        parts.insert(0, "node");
    }
    if parts.iter().any(|part| part.is_empty()) || (parts[0] == "node" && parts.len() < 3) {
        return Err(ConfigError::at(origin, "write it as node.key=value".to_owned()));
    }
    if let [kind @ ("node" | "archive"), name, ..] = parts[..] {
        let table = root.entry(kind).and_then(|table| table.value.entries());
        let known: Vec<&str> = table
            .unwrap_or_default()
            .iter()
            .map(|entry| entry.key.as_str())
            .collect();
        if !known.contains(&name) {
            let all =
                || Some(format!("this pipeline has {}", known.join(", "))).filter(|_| !known.is_empty());
            let hint = did_you_mean(name, known.iter().copied()).or_else(all);
            return Err(ConfigError::at(origin, format!("there is no {kind} `{name}`")).hint(hint));
        }
    }
    let value = SyntaxNode {
        at: origin.clone(),
        value: argument_value(text.trim()),
    };
    insert(root, &parts, value, &origin)
}

fn argument_value(text: &str) -> Value {
    let document = format!("value = {text}");
    let parsed = parse(&document).ok().and_then(|root| match root.value {
        Value::Table(mut entries) if entries.len() == 1 => entries.pop().map(|entry| entry.value.value),
        _ => None,
    });
    parsed.unwrap_or_else(|| Value::Text(text.to_owned()))
}

fn insert(
    table: &mut SyntaxNode,
    parts: &[&str],
    value: SyntaxNode,
    origin: &Origin,
) -> Result<(), ConfigError> {
    let Value::Table(entries) = &mut table.value else {
        return Err(ConfigError::at(
            origin.clone(),
            format!("`{}` lies inside a value, not a table", parts[0]),
        ));
    };
    let index = entries.iter().position(|entry| entry.key == parts[0]);
    let index = index.unwrap_or_else(|| {
        let empty = SyntaxNode {
            at: origin.clone(),
            value: Value::Table(Vec::new()),
        };
        entries.push(Entry {
            key: parts[0].to_owned(),
            at: origin.clone(),
            value: empty,
        });
        entries.len() - 1
    });
    if parts.len() > 1 {
        return insert(&mut entries[index].value, &parts[1..], value, origin);
    }
    entries[index].value = value;
    Ok(())
}

impl SyntaxNode {
    /// Returns the entries of a table, `None` for anything else.
    pub fn entries(&self) -> Option<&[Entry]> {
        match &self.value {
            Value::Table(entries) => Some(entries),
            _ => None,
        }
    }

    /// Returns the string, `None` for anything else.
    pub fn text(&self) -> Option<&str> {
        match &self.value {
            Value::Text(text) => Some(text),
            _ => None,
        }
    }

    /// Returns the entry of a key.
    pub fn entry(&self, key: &str) -> Option<&Entry> {
        self.entries()?.iter().find(|entry| entry.key == key)
    }

    /// Returns the place of a dotted path, or of its longest existing part. That of an item of a list is its list.
    pub fn place(&self, path: &str) -> Origin {
        let (first, rest) = path.split_once(['.', '[']).unwrap_or((path, ""));
        match self.entry(first) {
            Some(entry) if rest.is_empty() => entry.value.at.clone(),
            Some(entry) => entry.value.place(rest),
            None => self.at.clone(),
        }
    }

    /// Returns the value as JSON, the form in which stages take their parameters.
    pub fn json(&self) -> Json {
        match &self.value {
            Value::Text(text) => Json::String(text.clone()),
            Value::Truth(truth) => Json::Bool(*truth),
            Value::Integer(value) => {
                let unsigned = u64::try_from(*value).map(Number::from);
                Json::Number(unsigned.unwrap_or_else(|_| Number::from(*value as i64)))
            }
            Value::Float(value) => Number::from_f64(*value).map_or(Json::Null, Json::Number),
            Value::Array(items) => Json::Array(items.iter().map(Self::json).collect()),
            Value::Table(entries) => {
                let pairs = entries
                    .iter()
                    .map(|entry| (entry.key.clone(), entry.value.json()));
                Json::Object(pairs.collect::<Map<_, _>>())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn set_reads_numbers_lists_and_plain_words() {
        let mut root = parse("[archive.demo]\n[node.blur]\nmin = 3\n").unwrap();
        for argument in [
            "blur.min=0.5",
            "blur.rule=laplacian",
            "archive.demo.sols=1..=3",
            "blur.list=[1, 2]",
        ] {
            set(&mut root, argument).unwrap();
        }
        let json = root.json();
        assert_eq!(
            json["node"]["blur"],
            serde_json::json!({"min": 0.5, "rule": "laplacian", "list": [1, 2]})
        );
        assert_eq!(json["archive"]["demo"]["sols"], "1..=3");
    }

    #[test]
    fn a_tree_survives_json() {
        let text = "name = \"a\"\n[node.b]\nx = [1, 2.5, -3]\ny = {z = true}\nseed = 18446744073709551615\n";
        let tree = parse(text).unwrap();
        assert_eq!(of_json(&tree.json()).unwrap().json(), tree.json());
        assert!(of_json(&serde_json::json!({"a": [null]})).is_err());
    }

    #[test]
    fn set_without_a_node_or_a_value_is_refused() {
        let mut root = parse("").unwrap();
        for argument in ["blur", "=3", "blur=3", "blur..min=3"] {
            assert!(set(&mut root, argument).is_err(), "{argument}");
        }
    }

    #[test]
    fn set_on_a_node_or_an_archive_that_is_not_there_is_refused_with_the_nearest_name() {
        let mut root = parse("[archive.demo]\n[node.blur]\n[node.size]\n").unwrap();
        for (argument, message, hint) in [
            ("blurr.min=3", "there is no node `blurr`", "did you mean `blur`?"),
            ("node.siz.min=3", "there is no node `siz`", "did you mean `size`?"),
            (
                "train.steps=3",
                "there is no node `train`",
                "this pipeline has blur, size",
            ),
            (
                "archive.dem.sols=1",
                "there is no archive `dem`",
                "did you mean `demo`?",
            ),
        ] {
            let error = set(&mut root, argument).unwrap_err();
            assert_eq!(
                (error.message.as_str(), error.hint.as_deref()),
                (message, Some(hint))
            );
        }
    }

    #[test]
    fn all_64_bits_of_a_seed_arrive() {
        let root = parse("a = 18446744073709551615\nb = -9223372036854775808").err();
        let mut table = parse("[node.train]").unwrap();
        set(&mut table, "train.seed=18446744073709551615").unwrap();
        assert_eq!(table.json()["node"]["train"]["seed"], u64::MAX);
        assert!(root.is_none(), "{root:?}");
    }

    #[test]
    fn numbers_without_a_value_are_refused_at_their_place() {
        for text in ["a = nan", "a = inf", "a = 18446744073709551616", "a = 2026-11-21"] {
            let error = parse(text).unwrap_err();
            assert!(
                matches!(error.at, Origin::Text(ref range) if range.start == 4),
                "{text}: {error:?}"
            );
        }
    }
}
