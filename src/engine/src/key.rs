//! Keys: the digest of everything that a result depends on, and the same content as text.

use std::{collections::BTreeMap, fmt};

use marf_cache::{ContentHash, Digest, Visitor, digest_of, manifest_text};
use marf_stage::{EARLIER, Inputs, Listing, Stage, StageDef};
use serde::Serialize;

/// The key of a node, and the same content as text.
#[derive(Debug, Clone)]
pub(crate) struct Key {
    pub(crate) digest: Digest,
    pub(crate) manifest: String,
}

/// Everything that the result of a node depends on.
struct NodeContent<'a> {
    def: &'a StageDef,
    stage: &'a dyn Stage,
    inputs: &'a Inputs,
    listing: Option<&'a Listing>,
}

/// Returns the key of a node; that of a source holds its listing.
pub(crate) fn node_key(def: &StageDef, stage: &dyn Stage, inputs: &Inputs, listing: Option<&Listing>) -> Key {
    let content = NodeContent {
        def,
        stage,
        inputs,
        listing,
    };
    Key {
        digest: digest_of(&content),
        manifest: manifest_text(&content),
    }
}

impl ContentHash for NodeContent<'_> {
    fn walk(&self, visitor: &mut dyn Visitor) {
        let class = self.stage.backend_id();
        let more = usize::from(self.listing.is_some()) + usize::from(class.is_some());
        visitor.open("node", 4 + more);
        visitor.field("stage");
        visitor.text(self.def.name);
        visitor.field("version");
        visitor.unsigned(u64::from(self.def.version));
        visitor.field("params");
        self.stage.params().walk(visitor);
        visitor.field("inputs");
        walk_named(&self.inputs.0, visitor);
        if let Some(class) = class {
            visitor.field("backend_id");
            visitor.text(&class);
        }
        if let Some(listing) = self.listing {
            visitor.field("listing");
            walk_listing(listing, visitor);
        }
        visitor.close();
    }
}

/// Visits a listing; each shard is a field of its number, so that the text names a new sol.
fn walk_listing(listing: &Listing, visitor: &mut dyn Visitor) {
    visitor.open("listing", 2);
    visitor.field("shards");
    visitor.open("shards", listing.shards.len());
    for shard in &listing.shards {
        visitor.field(&shard.shard.to_string());
        visitor.digest(&shard.fingerprint);
    }
    visitor.close();
    visitor.field("companions");
    walk_named(&listing.companions, visitor);
    visitor.close();
}

/// Visits digests by name.
fn walk_named(digests: &BTreeMap<String, Digest>, visitor: &mut dyn Visitor) {
    visitor.open("named", digests.len());
    for (name, digest) in digests {
        visitor.field(name);
        visitor.digest(digest);
    }
    visitor.close();
}

/// What a part of a node's work depends on: a shard of a source, a table of measures, a step of a fold.
pub(crate) struct PartContent<'a> {
    /// The kind of part (`fetch`, `measure`, `fold`).
    pub(crate) what: &'static str,
    pub(crate) stage: &'static str,
    pub(crate) version: u32,
    pub(crate) params: &'a dyn ContentHash,
    pub(crate) of: &'a dyn ContentHash,
}

impl ContentHash for PartContent<'_> {
    fn walk(&self, visitor: &mut dyn Visitor) {
        visitor.open(self.what, 4);
        visitor.field("stage");
        visitor.text(self.stage);
        visitor.field("version");
        visitor.unsigned(u64::from(self.version));
        visitor.field("params");
        self.params.walk(visitor);
        visitor.field("of");
        self.of.walk(visitor);
        visitor.close();
    }
}

impl PartContent<'_> {
    /// Returns the key of the part.
    pub(crate) fn key(&self) -> Key {
        Key {
            digest: digest_of(self),
            manifest: manifest_text(self),
        }
    }
}

/// A difference between two keys. As text: `params.threshold: 0.2 -> 0.3`, `input photos changed`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Change {
    /// Path of the value (`params.threshold`).
    pub path: String,
    /// The old value; none if there was none.
    pub old: Option<String>,
    /// The new value; none if there is none.
    pub new: Option<String>,
}

/// Returns the differences between two manifests, in the order of the new one. The node's own earlier output comes
/// last, as it changes whenever anything else does.
pub(crate) fn differences(old: &str, new: &str) -> Vec<Change> {
    let (before, after) = (lines(old), lines(new));
    let earlier: BTreeMap<&str, &str> = before.iter().copied().collect();
    let later: BTreeMap<&str, &str> = after.iter().copied().collect();
    let change = |path: &str| Change {
        path: path.to_owned(),
        old: earlier.get(path).map(|&value| value.to_owned()),
        new: later.get(path).map(|&value| value.to_owned()),
    };
    let new_or_other = after
        .iter()
        .filter(|(path, value)| earlier.get(path) != Some(value));
    let gone = before.iter().filter(|(path, _)| !later.contains_key(path));
    let mut changes: Vec<Change> = new_or_other.chain(gone).map(|(path, _)| change(path)).collect();
    changes.sort_by_key(|change| change.path.strip_prefix("inputs.") == Some(EARLIER));
    changes
}

/// Splits a manifest into paths and values.
fn lines(manifest: &str) -> Vec<(&str, &str)> {
    manifest
        .lines()
        .filter_map(|line| line.split_once(" = "))
        .collect()
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let became = match (&self.old, &self.new) {
            (None, _) => "is new",
            (_, None) => "is gone",
            _ => "changed",
        };
        if let Some(input) = self.path.strip_prefix("inputs.") {
            return write!(f, "input {input} {became}");
        }
        if let Some(shard) = self.path.strip_prefix("listing.shards.") {
            return write!(f, "shard {shard} {became}");
        }
        if let Some(file) = self.path.strip_prefix("listing.companions.") {
            return write!(f, "file {file} {became}");
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
    /// Writes `path old -> new`.
    fn write_values(&self, f: &mut fmt::Formatter<'_>, path: &str) -> fmt::Result {
        let value = |value: &Option<String>| value.clone().unwrap_or_else(|| "absent".to_owned());
        write!(f, "{path} {} -> {}", value(&self.old), value(&self.new))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_is_one_plain_phrase() {
        let old = "stage = \"blur\"\nversion = 1\nparams.threshold = 0.2\ninputs.photos = aa\nlisting.shards.1 = ff\n";
        let cases = [
            (old.replace("0.2", "0.3"), "params.threshold: 0.2 -> 0.3"),
            (old.replace("= 1\n", "= 2\n"), "stage version 1 -> 2"),
            (old.replace("aa", "bb"), "input photos changed"),
            (format!("{old}listing.shards.2 = ee\n"), "shard 2 is new"),
            (old.replace("listing.shards.1 = ff\n", ""), "shard 1 is gone"),
            (
                format!("{old}params.rule = Robust\n"),
                "params.rule: absent -> Robust",
            ),
        ];
        for (new, expected) in cases {
            let changes = differences(old, &new);
            assert_eq!(changes.len(), 1, "{expected}");
            assert_eq!(changes[0].to_string(), expected);
        }
        assert_eq!(differences(old, old), vec![]);
    }
}
