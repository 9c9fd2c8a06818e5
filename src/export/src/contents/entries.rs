//! Contents of a crate: files that the graph describes, and objects of sets.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::{Action, Digest, manifest::Root};
use marf_engine::{LISTING, document};
use marf_model::{Run, RunNode};
use marf_stage::{COMPANIONS, PHOTOS, VERDICTS};

use super::file::{ACTIONS, Content, File, OBJECTS, Purpose, RUN_ROOT, is_plain};
use super::objects::{object, read_action, reader};
use super::sets::{leaves, unreadable};
use crate::error::ExportError;

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
    /// Lists of the files that sources read of their archives and where these came from, by node.
    pub origins: BTreeMap<String, Vec<Digest>>,
    /// Objects of all photos that sources brought in, whether or not they go along.
    pub photos: BTreeSet<Digest>,
    /// Decisions on each chosen photo.
    pub items: Vec<ItemVerdict>,
}

/// Decision of a node on a chosen photo.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ItemVerdict {
    /// Id of the photo.
    pub id: String,
    /// Name of the node.
    pub node: String,
    /// Path of the file that holds the verdict.
    pub path: String,
    /// Objects of the photo by role (`image`, `label`).
    pub blobs: BTreeMap<String, Digest>,
    /// Whether the node is the one that brought the photo in.
    pub is_source: bool,
}

impl Contents {
    /// Finds everything that belongs to a run without its photos. `file_name` returns the file name of an
    /// output that is one file.
    ///
    /// # Errors
    /// An object that cannot be read or is not what it should be.
    pub fn new(run: &Run<'_>, file_name: fn(&str) -> Option<&str>) -> Result<Self, ExportError> {
        let mut contents = Self::default();
        contents.add_bytes(RUN_ROOT, "run root", run.root()?);
        for (name, output) in &run.record.documents {
            // The report shows photos and results.
            let purpose = match name.as_str() {
                document::REPORT | document::METRICS => Purpose::Data,
                _ => Purpose::Record,
            };
            contents.add(name.clone(), name.clone(), output.digest, purpose);
        }
        for node in &run.nodes {
            contents.add_action(run, node)?;
        }
        for node in &run.nodes {
            contents.add_outputs(run, node, file_name)?;
        }
        for node in &run.nodes {
            contents.add_inputs(run, node)?;
        }
        Ok(contents)
    }

    /// Adds a file of these bytes.
    pub(super) fn add_bytes(&mut self, path: &str, name: &str, bytes: Vec<u8>) {
        let file = File {
            path: path.to_owned(),
            name: name.to_owned(),
            content: Content::Bytes(bytes),
            purpose: Purpose::Record,
        };
        self.files.insert(path.to_owned(), file);
    }

    /// Adds an object under a path, or under its digest if the path is taken or needs escapes somewhere.
    pub(super) fn add(&mut self, path: String, name: String, digest: Digest, purpose: Purpose) {
        if self.paths.contains_key(&digest) {
            return;
        }
        let path = if is_plain(&path) && !self.files.contains_key(&path) {
            path
        } else {
            format!("{OBJECTS}{digest}")
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
    pub(super) fn add_object(&mut self, digest: Digest, purpose: Purpose) {
        if !self.paths.contains_key(&digest) {
            let known = self.objects.entry(digest).or_insert(purpose);
            *known = (*known).min(purpose);
        }
    }

    fn add_action(&mut self, run: &Run<'_>, node: &RunNode) -> Result<(), ExportError> {
        // A finished run has a key for every node.
        let Some(key) = node.run.key else { return Ok(()) };
        let action = read_action(run, node)?;
        let path = format!("{ACTIONS}{key}.json");
        let title = format!("action of `{}`", node.run.name);
        self.add(path, title, key, Purpose::Record);
        self.actions.insert(key, action);
        Ok(())
    }

    /// Returns the action of a node.
    pub fn action(&self, node: &RunNode) -> Option<&Action> {
        self.actions.get(&node.run.key?)
    }

    /// Returns the lists of the files that a node read of an archive.
    pub fn origins(&self, node: &RunNode) -> &[Digest] {
        self.origins.get(&node.run.name).map_or(&[], Vec::as_slice)
    }

    fn add_outputs(
        &mut self,
        run: &Run<'_>,
        node: &RunNode,
        file_name: fn(&str) -> Option<&str>,
    ) -> Result<(), ExportError> {
        let node = &node.run;
        for (name, output) in &node.outputs {
            let title = format!("`{name}` of `{}`", node.name);
            let is_set = matches!(name.as_str(), PHOTOS | VERDICTS);
            let ending = if is_set { "jsonl" } else { "json" };
            let file = file_name(name).map_or_else(|| format!("{name}.{ending}"), str::to_owned);
            if is_set {
                self.add_set(run, &output.digest, &title)?;
            }
            if name == COMPANIONS {
                self.add_companions(run, &output.digest, &title)?;
            }
            let purpose = if is_set || name == COMPANIONS {
                Purpose::Record
            } else {
                Purpose::Data
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
    fn add_inputs(&mut self, run: &Run<'_>, node: &RunNode) -> Result<(), ExportError> {
        let action = self.action(node);
        let inputs = action.map(|action| action.inputs.clone()).unwrap_or_default();
        for (name, digest) in inputs {
            if self.paths.contains_key(&digest) {
                continue;
            }
            let title = format!("input `{name}` of `{}`", node.run.name);
            let bytes = object(run, &digest, || title.clone())?;
            // The listing of an archive is a set whose leaves are fingerprints. Any other input is not a set.
            self.add_blocks(&bytes);
            let ending = if name == LISTING { ".jsonl" } else { "" };
            self.add(
                format!("inputs/{}/{name}{ending}", node.run.name),
                title,
                digest,
                Purpose::Record,
            );
        }
        let name = &node.run.name;
        let origins = run.origins(node)?;
        for (number, digest) in origins.iter().enumerate() {
            let title = format!("files that `{name}` read, list {number}");
            let path = format!("inputs/{name}/origins-{number:05}.jsonl");
            self.add(path, title, *digest, Purpose::Record);
        }
        if !origins.is_empty() {
            self.origins.insert(name.clone(), origins);
        }
        Ok(())
    }

    /// Adds the blocks that the bytes of a root name. Other bytes name none.
    fn add_blocks(&mut self, root: &[u8]) {
        for block in Root::blocks(root).unwrap_or_default() {
            self.add_object(block.digest, Purpose::Record);
        }
    }

    fn add_set(&mut self, run: &Run<'_>, root: &Digest, title: &str) -> Result<(), ExportError> {
        let leaves = leaves(root, &reader(run), title)?;
        self.add_blocks(&object(run, root, || title.to_owned())?);
        for leaf in leaves {
            self.add_object(leaf.leaf, Purpose::Record);
        }
        Ok(())
    }

    fn add_companions(&mut self, run: &Run<'_>, digest: &Digest, title: &str) -> Result<(), ExportError> {
        let bytes = object(run, digest, || title.to_owned())?;
        let files: BTreeMap<String, Digest> =
            serde_json::from_slice(&bytes).map_err(|error| unreadable(title, error))?;
        for (name, digest) in files {
            let path = format!("companions/{name}");
            self.add(path, format!("companion file `{name}`"), digest, Purpose::Data);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_object_is_one_file_whoever_made_it() {
        let mut contents = Contents::default();
        let (one, two) = (Digest::from_content(b"1"), Digest::from_content(b"2"));
        contents.add_object(one, Purpose::Data);
        contents.add("outputs/a/x.png".into(), "first".into(), one, Purpose::Data);
        contents.add("outputs/b/x.png".into(), "second".into(), one, Purpose::Data);
        contents.add("outputs/a/x.png".into(), "taken".into(), two, Purpose::Data);
        contents.add(
            "outputs/a/x y.png".into(),
            "not plain".into(),
            Digest::from_content(b"3"),
            Purpose::Data,
        );
        contents.add_object(one, Purpose::Record);
        let mut expected = [
            format!("objects/{two}"),
            format!("objects/{}", Digest::from_content(b"3")),
            "outputs/a/x.png".to_owned(),
        ];
        expected.sort();
        let paths: Vec<String> = contents.files.keys().cloned().collect();
        assert_eq!(paths, expected);
        assert_eq!(contents.files["outputs/a/x.png"].name, "first");
        assert!(contents.objects.is_empty());
    }
}
