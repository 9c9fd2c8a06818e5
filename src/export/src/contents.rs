//! Which objects of the store go into a crate, and under which paths.

mod items;
mod sets;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use marf_cache::{Action, Digest, manifest::Root};
use marf_engine::{LISTING, document};
use marf_stage::{COMPANIONS, PHOTOS, VERDICTS};

use crate::error::ExportError;
use crate::run::{Node, Run};

pub use items::ItemVerdict;
pub use sets::{leaves, rows, verdicts};

/// Reads an object of the store and verifies it; the error is a sentence for people.
pub type ReadObject<'a> = dyn Fn(&Digest) -> Result<Arc<[u8]>, String> + 'a;

/// Folder of the payload for objects under the names of their digests.
pub const OBJECTS: &str = "objects/";
/// The run root.
pub const RUN_ROOT: &str = "run.json";
/// Folder of the actions, one file a key.
pub const ACTIONS: &str = "actions/";

/// Of which photos the bytes and every verdict go along.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Photos {
    /// The bytes of all, and no lineage photo by photo.
    All,
    /// These, by id, with their lineage photo by photo.
    Chosen(Vec<String>),
}

/// Where the bytes of a file come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Content {
    /// An object of the store.
    Object(Digest),
    /// These bytes.
    Bytes(Vec<u8>),
}

/// What a file is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Purpose {
    /// It tells what happened; it is always there.
    Record,
    /// It went in or came out; a crate without data names it only.
    Data,
}

/// A file of the payload that the graph describes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct File {
    /// Its path in the payload.
    pub path: String,
    /// What it is called, for people.
    pub name: String,
    /// Its bytes.
    pub content: Content,
    /// What it is for.
    pub purpose: Purpose,
}

/// All that goes into a crate.
#[derive(Debug, Default)]
pub struct Contents {
    /// Files that the graph describes, by path.
    pub files: BTreeMap<String, File>,
    /// Paths of described objects.
    pub paths: BTreeMap<Digest, String>,
    /// Objects that go along under the names of their digests.
    pub objects: BTreeMap<Digest, Purpose>,
    /// Actions by key.
    pub actions: BTreeMap<Digest, Action>,
    /// What was decided on each chosen photo.
    pub items: Vec<ItemVerdict>,
}

impl Contents {
    /// Finds everything that belongs to a run.
    ///
    /// # Errors
    /// An object that cannot be read or is not what it should be, or a chosen photo that the run does not have.
    pub fn of(run: &Run, read: &ReadObject<'_>, photos: &Photos) -> Result<Self, ExportError> {
        let mut contents = Self::default();
        contents.add_bytes(RUN_ROOT, "run root", run.root.clone());
        for (name, digest) in &run.documents {
            // The report shows photos and results.
            let purpose = match name.as_str() {
                document::REPORT | document::METRICS => Purpose::Data,
                _ => Purpose::Record,
            };
            contents.add(name.clone(), name.clone(), *digest, purpose);
        }
        for node in &run.nodes {
            contents.add_action(node, read)?;
        }
        for node in &run.nodes {
            contents.add_outputs(node, read)?;
        }
        for node in &run.nodes {
            contents.add_inputs(node, read)?;
        }
        let chosen = match photos {
            Photos::All => {
                let needs = run.nodes.iter().flat_map(|node| &node.needs);
                needs.for_each(|digest| contents.add_object(*digest, Purpose::Data));
                None
            }
            Photos::Chosen(ids) => Some(ids.iter().map(String::as_str).collect::<BTreeSet<_>>()),
        };
        items::add_photos(&mut contents, run, read, chosen.as_ref())?;
        Ok(contents)
    }

    fn add_bytes(&mut self, path: &str, name: &str, bytes: Vec<u8>) {
        let file = File {
            path: path.to_owned(),
            name: name.to_owned(),
            content: Content::Bytes(bytes),
            purpose: Purpose::Record,
        };
        self.files.insert(path.to_owned(), file);
    }

    /// Adds an object under a path, or under its digest if the path is taken or needs escapes somewhere.
    fn add(&mut self, path: String, name: String, digest: Digest, purpose: Purpose) {
        if self.paths.contains_key(&digest) {
            return;
        }
        let path = match is_plain(&path) && !self.files.contains_key(&path) {
            true => path,
            false => format!("{OBJECTS}{digest}"),
        };
        let file = File {
            path: path.clone(),
            name,
            content: Content::Object(digest),
            purpose,
        };
        self.objects.remove(&digest);
        self.paths.insert(digest, path.clone());
        self.files.insert(path, file);
    }

    /// Adds an object that the graph does not describe.
    fn add_object(&mut self, digest: Digest, purpose: Purpose) {
        if !self.paths.contains_key(&digest) {
            let known = self.objects.entry(digest).or_insert(purpose);
            *known = (*known).min(purpose);
        }
    }

    fn add_action(&mut self, node: &Node, read: &ReadObject<'_>) -> Result<(), ExportError> {
        let action = action_of(node, read)?;
        let path = format!("{ACTIONS}{}.json", node.key);
        self.add(
            path,
            format!("action of `{}`", node.name),
            node.key,
            Purpose::Record,
        );
        self.actions.insert(node.key, action);
        Ok(())
    }

    fn add_outputs(&mut self, node: &Node, read: &ReadObject<'_>) -> Result<(), ExportError> {
        for (name, output) in &node.outputs {
            let title = format!("`{name}` of `{}`", node.name);
            let is_set = matches!(name.as_str(), PHOTOS | VERDICTS);
            let file = match (&output.file, is_set) {
                (Some(file), _) => file.clone(),
                (None, true) => format!("{name}.jsonl"),
                (None, false) => format!("{name}.json"),
            };
            if is_set {
                self.add_set(&output.digest, read, &title)?;
            }
            if name == COMPANIONS {
                self.add_companions(&output.digest, read, &title)?;
            }
            let purpose = match is_set || name == COMPANIONS {
                true => Purpose::Record,
                false => Purpose::Data,
            };
            self.add(
                format!("outputs/{}/{file}", node.name),
                title,
                output.digest,
                purpose,
            );
        }
        Ok(())
    }

    /// Adds what a node read and no node of the run made: what an archive listed, an earlier output.
    fn add_inputs(&mut self, node: &Node, read: &ReadObject<'_>) -> Result<(), ExportError> {
        let action = self.actions.get(&node.key);
        let inputs = action.map(|action| action.inputs.clone()).unwrap_or_default();
        for (name, digest) in inputs {
            if self.paths.contains_key(&digest) {
                continue;
            }
            let title = format!("input `{name}` of `{}`", node.name);
            let bytes = object(read, &digest, || title.clone())?;
            // What an archive lists is a set whose leaves are fingerprints; any other input is no set.
            self.add_blocks(&bytes);
            let ending = if name == LISTING { ".jsonl" } else { "" };
            self.add(
                format!("inputs/{}/{name}{ending}", node.name),
                title,
                digest,
                Purpose::Record,
            );
        }
        for (number, digest) in node.origins.iter().enumerate() {
            let title = format!("files that `{}` read, list {number}", node.name);
            let path = format!("inputs/{}/origins-{number:05}.jsonl", node.name);
            self.add(path, title, *digest, Purpose::Record);
        }
        Ok(())
    }

    /// Adds the blocks that the bytes of a root name; bytes that are no root name none.
    fn add_blocks(&mut self, root: &[u8]) {
        for block in Root::blocks(root).unwrap_or_default() {
            self.add_object(block.digest, Purpose::Record);
        }
    }

    fn add_set(&mut self, root: &Digest, read: &ReadObject<'_>, title: &str) -> Result<(), ExportError> {
        let leaves = leaves(root, read, title)?;
        self.add_blocks(&object(read, root, || title.to_owned())?);
        for leaf in leaves {
            self.add_object(leaf.leaf, Purpose::Record);
        }
        Ok(())
    }

    fn add_companions(
        &mut self,
        digest: &Digest,
        read: &ReadObject<'_>,
        title: &str,
    ) -> Result<(), ExportError> {
        let bytes = object(read, digest, || title.to_owned())?;
        let files: BTreeMap<String, Digest> =
            serde_json::from_slice(&bytes).map_err(|error| ExportError::BadSet {
                what: title.to_owned(),
                cause: error.into(),
            })?;
        for (name, digest) in files {
            let path = format!("companions/{name}");
            self.add(path, format!("companion file `{name}`"), digest, Purpose::Data);
        }
        Ok(())
    }
}

/// Reads the action of a node.
pub(crate) fn action_of(node: &Node, read: &ReadObject<'_>) -> Result<Action, ExportError> {
    let bytes = object(read, &node.key, || format!("the action of `{}`", node.name))?;
    Action::decode(&bytes).map_err(|cause| ExportError::BadAction {
        node: node.name.clone(),
        cause,
    })
}

/// Reads an object, or says which one cannot be read.
pub(crate) fn object(
    read: &ReadObject<'_>,
    digest: &Digest,
    what: impl FnOnce() -> String,
) -> Result<Arc<[u8]>, ExportError> {
    read(digest).map_err(|cause| ExportError::Object {
        digest: *digest,
        what: what(),
        cause,
    })
}

/// Tells whether a text is a path or identifier that is the same in a file system, a manifest and a URI.
pub(crate) fn is_plain(text: &str) -> bool {
    let is_plain = |char: char| char.is_ascii_alphanumeric() || matches!(char, '.' | '_' | '-' | '/');
    crate::bag::is_safe(text) && text.chars().all(is_plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_object_is_one_file_whoever_made_it() {
        let mut contents = Contents::default();
        let (one, two) = (Digest::of(b"1"), Digest::of(b"2"));
        contents.add_object(one, Purpose::Data);
        contents.add("outputs/a/x.png".into(), "first".into(), one, Purpose::Data);
        contents.add("outputs/b/x.png".into(), "second".into(), one, Purpose::Data);
        contents.add("outputs/a/x.png".into(), "taken".into(), two, Purpose::Data);
        contents.add(
            "outputs/a/x y.png".into(),
            "not plain".into(),
            Digest::of(b"3"),
            Purpose::Data,
        );
        contents.add_object(one, Purpose::Record);
        let mut expected = [
            format!("objects/{two}"),
            format!("objects/{}", Digest::of(b"3")),
            "outputs/a/x.png".to_owned(),
        ];
        expected.sort();
        let paths: Vec<String> = contents.files.keys().cloned().collect();
        assert_eq!(paths, expected);
        assert_eq!(contents.files["outputs/a/x.png"].name, "first");
        assert!(contents.objects.is_empty());
    }
}
