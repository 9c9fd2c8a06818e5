//! Keys: the action of a node or of a part of its work, and how two actions differ.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use marf_cache::{ACTION_FORMAT, Action, ChildVersion, Digest, LISTING, Store, StoreError, canonical_json};
use marf_stage::{EARLIER, Inputs, Stage, StageDef, StageError, Work};
use serde::Serialize;
use serde_json::Value;

use crate::{
    errors::contract_violation,
    executor::{Executor, backend_of},
};

/// Stages by name.
pub(crate) type StageTable = BTreeMap<&'static str, StageDef>;

/// An action with its key.
#[derive(Debug, Clone)]
pub(crate) struct Key {
    pub(crate) digest: Digest,
    pub(crate) action: Action,
}

impl Key {
    pub(crate) fn new(action: Action) -> Self {
        Self {
            digest: action.key(),
            action,
        }
    }
}

/// Returns the key of a node. `executor` computes the node or its children, if it takes them.
///
/// # Errors
/// A child of a stage that is not in the table or refuses its parameters, or a device that the computing machine does not have.
pub(crate) fn node_key(
    table: &StageTable,
    executor: Option<&dyn Executor>,
    def: &StageDef,
    stage: &dyn Stage,
    inputs: &Inputs,
) -> Result<Key, StageError> {
    let mut children = BTreeMap::new();
    add_children(table, executor, stage, &mut children)?;
    Ok(Key::new(Action {
        action: ACTION_FORMAT,
        stage: def.name.to_owned(),
        version: def.version,
        part: None,
        shard: None,
        params: stage.params(),
        inputs: inputs.0.clone(),
        backend: backend_of(executor, def.name, stage)?,
        children,
    }))
}

/// Adds the stages that the children of a node are of, and those of their own children.
fn add_children(
    table: &StageTable,
    executor: Option<&dyn Executor>,
    stage: &dyn Stage,
    children: &mut BTreeMap<String, ChildVersion>,
) -> Result<(), StageError> {
    let Work::Expand(expand) = stage.work() else {
        return Ok(());
    };
    for child in expand.children() {
        let def = table.get(child.stage).ok_or_else(|| {
            contract_violation(format!(
                "its children are of the stage `{}`, which does not exist",
                child.stage
            ))
        })?;
        let bound = (def.bind)(child.params)
            .map_err(|error| contract_violation(format!("children of stage `{}`: {error}", child.stage)))?;
        let version = ChildVersion {
            version: def.version,
            backend: backend_of(executor, child.stage, bound.as_ref())?,
        };
        children.insert(child.stage.to_owned(), version);
        add_children(table, executor, bound.as_ref(), children)?;
    }
    Ok(())
}

/// Returns the action of a key.
///
/// # Errors
/// A store that cannot be read. A lost action, or bytes that are not an action, give None.
pub fn action_at(store: &Store, key: &Digest) -> Result<Option<Action>, StoreError> {
    match store.get(key) {
        Err(error) if error.lost().is_some() => Ok(None),
        other => Ok(Action::decode(&other?).ok()),
    }
}

/// A difference between two keys. As text: `params.threshold: 0.2 -> 0.3`, `input photos changed`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Change {
    /// Path of the value (`params.threshold`).
    pub path: String,
    /// The old value. None if there was none.
    pub old: Option<String>,
    /// The new value. None if there is none.
    pub new: Option<String>,
}

const SHARDS: &str = "listing.";
const FILES: &str = "files.";
const PHOTOS_OF: &str = "photos.";

/// Returns the path of a shard of a listing. Leading zeros make paths sort by number.
pub(crate) fn shard_path(shard: u32) -> String {
    format!("{SHARDS}{shard:05}")
}

/// Returns the path of a file of a shard.
pub(crate) fn file_path(shard: u32, name: &str) -> String {
    format!("{FILES}{shard:05}/{name}")
}

/// Returns the path of a photo of a shard.
pub(crate) fn photo_path(shard: u32, id: &str) -> String {
    format!("{PHOTOS_OF}{shard:05}/{id}")
}

/// Returns the differences between two actions, sorted by path. The node's own earlier output comes last, as it changes
/// whenever anything else does.
pub fn differences(old: &Action, new: &Action) -> Vec<Change> {
    let json = |action: &Action| serde_json::to_value(action).unwrap_or_default();
    let mut changes = changes(&json(old), &json(new));
    changes.sort_by_key(|change| change.path.strip_prefix("inputs.") == Some(EARLIER));
    changes
}

/// Returns the values that differ between two JSON documents, sorted by their dotted paths.
pub fn changes(old: &Value, new: &Value) -> Vec<Change> {
    changes_between(&leaves(old), &leaves(new))
}

/// Returns the differences between two tables, sorted by name.
pub(crate) fn changes_between(old: &BTreeMap<String, String>, new: &BTreeMap<String, String>) -> Vec<Change> {
    let paths: BTreeSet<&String> = old.keys().chain(new.keys()).collect();
    let differs = paths.into_iter().filter(|path| old.get(*path) != new.get(*path));
    differs
        .map(|path| Change {
            path: path.clone(),
            old: old.get(path).cloned(),
            new: new.get(path).cloned(),
        })
        .collect()
}

/// Returns the values of a document by their dotted paths. A list of names is one value.
fn leaves(json: &Value) -> BTreeMap<String, String> {
    let mut leaves = BTreeMap::new();
    add_leaves(String::new(), json, &mut leaves);
    leaves
}

fn add_leaves(path: String, value: &Value, leaves: &mut BTreeMap<String, String>) {
    let below = |name: &str| {
        if path.is_empty() {
            name.to_owned()
        } else {
            format!("{path}.{name}")
        }
    };
    match value {
        Value::Object(table) if !table.is_empty() => table
            .iter()
            .for_each(|(name, value)| add_leaves(below(name), value, leaves)),
        Value::Array(values) if values.iter().any(|value| !value.is_string()) => (0..)
            .zip(values)
            .for_each(|(index, value)| add_leaves(below(&index.to_string()), value, leaves)),
        Value::String(text) if is_digest_path(&path) => drop(leaves.insert(path, text.clone())),
        // In the form of keys, so that 3 and 3.0 are one value.
        leaf => drop(leaves.insert(path, String::from_utf8_lossy(&canonical_json(leaf)).into_owned())),
    }
}

fn is_digest_path(path: &str) -> bool {
    path.starts_with("inputs.")
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let became = match (&self.old, &self.new) {
            (None, _) => "is new",
            (_, None) => "is gone",
            _ => "changed",
        };
        if let Some(input) = self.path.strip_prefix("inputs.") {
            return match input {
                LISTING => write!(f, "the archive listing {became}"),
                _ => write!(f, "input {input} {became}"),
            };
        }
        if let Some(shard) = self.shard() {
            return write!(f, "shard {shard} {became}");
        }
        for (prefix, what) in [(FILES, "file"), (PHOTOS_OF, "photo")] {
            if let Some(name) = self.path.strip_prefix(prefix) {
                return write!(f, "{what} {name} {became}");
            }
        }
        if let Some((stage, "version")) = self
            .path
            .strip_prefix("children.")
            .and_then(|path| path.rsplit_once('.'))
        {
            return self.write_values(f, &format!("version of stage {stage}"));
        }
        let path = match self.path.as_str() {
            "version" => "stage version",
            "stage" => "stage",
            other => return self.write_values(f, &format!("{other}:")),
        };
        self.write_values(f, path)
    }
}

impl Change {
    /// Returns the shard of a listing that differs, if that is the difference.
    pub(crate) fn shard(&self) -> Option<u32> {
        self.path.strip_prefix(SHARDS)?.parse().ok()
    }

    /// Writes `path old -> new`, or which names of a list are new and which are gone.
    fn write_values(&self, f: &mut fmt::Formatter<'_>, path: &str) -> fmt::Result {
        let names = |value: &Option<String>| match value {
            Some(value) => serde_json::from_str::<BTreeSet<String>>(value).ok(),
            None => Some(BTreeSet::new()),
        };
        if let (Some(old), Some(new)) = (names(&self.old), names(&self.new))
            && old != new
        {
            let words = [("added", new.difference(&old)), ("removed", old.difference(&new))];
            let words = words.map(|(word, names)| named(word, &names.collect::<Vec<_>>()));
            let words: Vec<String> = words.into_iter().flatten().collect();
            return write!(f, "{path} {}", words.join(", "));
        }
        let value = |value: &Option<String>| value.clone().unwrap_or_else(|| "absent".to_owned());
        write!(f, "{path} {} -> {}", value(&self.old), value(&self.new))
    }
}

/// Returns `added "a", "b" and 4 more`. None of no names.
fn named(word: &str, names: &[&String]) -> Option<String> {
    const MOST: usize = 3;
    let shown: Vec<String> = names.iter().take(MOST).map(|name| format!("{name:?}")).collect();
    let more = names.len().saturating_sub(MOST);
    let rest = if more > 0 {
        format!(" and {more} more")
    } else {
        String::new()
    };
    (!names.is_empty()).then(|| format!("{word} {}{rest}", shown.join(", ")))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    fn action() -> Action {
        Action {
            action: ACTION_FORMAT,
            stage: "blur".to_owned(),
            version: 1,
            part: None,
            shard: None,
            params: json!({"threshold": 0.2}),
            inputs: BTreeMap::from([("photos".to_owned(), Digest::from_content(b"a"))]),
            backend: None,
            children: BTreeMap::from([(
                "train".to_owned(),
                ChildVersion {
                    version: 4,
                    backend: None,
                },
            )]),
        }
    }

    #[test]
    fn a_difference_is_one_plain_phrase() {
        type Edit = fn(&mut Action);
        let cases: [(Edit, &str); 7] = [
            (
                |action| action.params["threshold"] = json!(0.3),
                "params.threshold: 0.2 -> 0.3",
            ),
            (|action| action.version = 2, "stage version 1 -> 2"),
            (
                |action| {
                    action
                        .inputs
                        .extend([("photos".to_owned(), Digest::from_content(b"b"))])
                },
                "input photos changed",
            ),
            (
                |action| {
                    action
                        .inputs
                        .extend([(LISTING.to_owned(), Digest::from_content(b"b"))])
                },
                "the archive listing is new",
            ),
            (
                |action| action.params["rule"] = json!("Robust"),
                "params.rule: absent -> \"Robust\"",
            ),
            (
                |action| action.backend = Some("a GPU".to_owned()),
                "backend: absent -> \"a GPU\"",
            ),
            (
                |action| action.children.values_mut().for_each(|child| child.version = 5),
                "version of stage train 4 -> 5",
            ),
        ];
        for (edit, expected) in cases {
            let mut new = action();
            edit(&mut new);
            let changes = differences(&action(), &new);
            assert_eq!(changes.len(), 1, "{expected}");
            assert_eq!(changes[0].to_string(), expected);
        }
        assert_eq!(differences(&action(), &action()), vec![]);
    }

    #[test]
    fn names_of_a_list_are_told_as_added_and_removed() {
        let with = |names: Value| Action {
            params: json!({"by_hand": {"keep": names}}),
            ..action()
        };
        let told = |old: Value, new: Value| {
            let found = differences(&with(old), &with(new));
            found.iter().map(ToString::to_string).collect::<Vec<_>>()
        };
        let (few, many) = (json!(["a"]), json!(["b", "c", "d", "e", "f"]));
        assert_eq!(told(json!([]), few.clone()), ["params.by_hand.keep: added \"a\""]);
        assert_eq!(
            told(few, many),
            ["params.by_hand.keep: added \"b\", \"c\", \"d\" and 2 more, removed \"a\""]
        );
        assert_eq!(
            told(json!([0, 1]), json!([0, 2])),
            ["params.by_hand.keep.1: 1 -> 2"]
        );
        assert_eq!(
            told(json!(["a", "b"]), json!(["b", "a"])),
            ["params.by_hand.keep: [\"a\",\"b\"] -> [\"b\",\"a\"]"]
        );
    }

    /// Parameters as a stage gives them: whole numbers as floats, empty lists and tables among them.
    fn params() -> impl Strategy<Value = Value> {
        let leaf = prop_oneof![
            Just(Value::Null),
            any::<bool>().prop_map(Value::from),
            any::<i64>().prop_map(Value::from),
            any::<u64>().prop_map(Value::from),
            (-1e9..1e9_f64).prop_map(|number| json!(number.trunc())),
            any::<f32>().prop_map(|number| json!(number)),
            any::<f64>().prop_map(|number| json!(number)),
            ".{0,4}".prop_map(Value::from),
        ];
        let value = leaf.prop_recursive(3, 16, 4, |inner| {
            prop_oneof![
                prop::collection::vec(inner.clone(), 0..4).prop_map(Value::from),
                prop::collection::btree_map("[a-z]{1,3}", inner, 0..4).prop_map(|table| json!(table)),
            ]
        });
        prop::collection::btree_map("[a-z]{1,3}", value, 1..6).prop_map(|table| json!(table))
    }

    /// Returns the pointers of all values without values below them.
    fn pointers(value: &Value, path: &str, found: &mut Vec<String>) {
        match value {
            Value::Object(table) if !table.is_empty() => table
                .iter()
                .for_each(|(name, value)| pointers(value, &format!("{path}/{name}"), found)),
            Value::Array(values) if values.iter().any(|value| !value.is_string()) => (0..)
                .zip(values)
                .for_each(|(at, value): (usize, _)| pointers(value, &format!("{path}/{at}"), found)),
            _ => found.push(path.to_owned()),
        }
    }

    proptest! {
        #[test]
        fn parameters_that_a_key_holds_do_not_differ_from_themselves(params in params()) {
            let now = Action { params, ..action() };
            let stored = Action::decode(&now.encode()).unwrap();
            prop_assert_eq!(differences(&stored, &now), vec![]);
        }

        #[test]
        fn one_value_that_changed_is_the_one_difference(params in params(), pick: prop::sample::Index) {
            let stored = Action::decode(&Action { params: params.clone(), ..action() }.encode()).unwrap();
            let mut paths = Vec::new();
            pointers(&params, "", &mut paths);
            let path = pick.get(&paths);
            let mut changed = params.clone();
            *changed.pointer_mut(path).unwrap() = json!(0.123_456_789);
            let found = differences(&stored, &Action { params: changed, ..action() });
            let paths: Vec<String> = found.into_iter().map(|change| change.path).collect();
            prop_assert_eq!(paths, [format!("params{}", path.replace('/', "."))]);
        }
    }
}
