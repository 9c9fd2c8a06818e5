//! in-toto statements, version 1, with SLSA provenance, version 1: who made these bytes, from which.

use std::collections::BTreeSet;

use marf_cache::{Digest, Sha256};
use serde_json::{Value, json};

use crate::bag::FileDigest;
use crate::contents::{ReadObject, action_of, object};
use crate::error::ExportError;
use crate::run::{Node, Run};
use crate::time::{end_of, iso_time};

/// Type of a statement.
const STATEMENT_TYPE: &str = "https://in-toto.io/Statement/v1";
/// Type of what it says.
const PREDICATE_TYPE: &str = "https://slsa.dev/provenance/v1";
/// How the program builds: what the parameters mean is told in ARCHITECTURE.md.
const BUILD_TYPE: &str = "urn:x-marf:build:1";
const BUILDER: &str = "urn:x-marf:builder:1";

/// Bytes that a statement is about.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Subject {
    /// Their name.
    pub name: String,
    /// Their digests.
    pub digest: FileDigest,
}

impl Subject {
    /// Returns bytes with a name.
    pub fn new(name: impl Into<String>, digest: FileDigest) -> Self {
        Self {
            name: name.into(),
            digest,
        }
    }

    fn descriptor(&self) -> Value {
        json!({
            "name": self.name,
            "digest": {
                "sha256": self.digest.sha256.to_string(),
                "blake3": self.digest.blake3.to_string(),
            },
        })
    }
}

/// Returns the statement that a node made these bytes.
///
/// # Errors
/// An object that cannot be read.
pub fn statement_on_node(
    run: &Run,
    node: &Node,
    subjects: &[Subject],
    read: &ReadObject<'_>,
) -> Result<Vec<u8>, ExportError> {
    let action = action_of(node, read)?;
    let mut dependencies = documents(run, read)?;
    let inputs = action.inputs.iter();
    let inputs = inputs.map(|(name, digest)| (format!("input {name}"), *digest));
    dependencies.extend(subjects_of(inputs.chain(origins(node)), read)?);
    let times = node.started_unix_s.map(|started| (started, node.seconds));
    let parameters = json!({
        "pipeline": run.pipeline,
        "node": node.name,
        "key": node.key,
        "action": action,
    });
    Ok(encode(run, parameters, &dependencies, times, subjects))
}

/// Returns the statement that a run made these bytes.
///
/// # Errors
/// An object that cannot be read.
pub fn statement_on_run(
    run: &Run,
    subjects: &[Subject],
    read: &ReadObject<'_>,
) -> Result<Vec<u8>, ExportError> {
    let outputs = run.nodes.iter().flat_map(|node| node.outputs.values());
    let made: BTreeSet<Digest> = outputs.map(|output| output.digest).collect();
    let mut dependencies = documents(run, read)?;
    for node in &run.nodes {
        let inputs = action_of(node, read)?.inputs.into_iter();
        let foreign = inputs.filter(|(_, digest)| !made.contains(digest));
        let named = foreign.map(|(name, digest)| (format!("{} input {name}", node.name), digest));
        dependencies.extend(subjects_of(named.chain(origins(node)), read)?);
    }
    let parameters = json!({ "pipeline": run.pipeline, "command": run.command });
    let times = Some((run.started_unix_s, run.seconds));
    Ok(encode(run, parameters, &dependencies, times, subjects))
}

fn documents(run: &Run, read: &ReadObject<'_>) -> Result<Vec<Subject>, ExportError> {
    let named = run.documents.iter().map(|(name, digest)| (name.clone(), *digest));
    subjects_of(named, read)
}

fn origins(node: &Node) -> impl Iterator<Item = (String, Digest)> {
    let lists = (0..).zip(&node.origins);
    lists.map(|(number, digest)| (format!("{} read, list {number}", node.name), *digest))
}

/// Reads objects and returns them with their digests.
///
/// # Errors
/// An object that cannot be read.
pub fn subjects_of(
    named: impl Iterator<Item = (String, Digest)>,
    read: &ReadObject<'_>,
) -> Result<Vec<Subject>, ExportError> {
    let subject = |(name, digest): (String, Digest)| {
        let bytes = object(read, &digest, || name.clone())?;
        Ok(Subject::new(name, FileDigest::of(&bytes)))
    };
    named.map(subject).collect()
}

fn encode(
    run: &Run,
    parameters: Value,
    dependencies: &[Subject],
    times: Option<(u64, f64)>,
    subjects: &[Subject],
) -> Vec<u8> {
    let descriptors = |subjects: &[Subject]| subjects.iter().map(Subject::descriptor).collect::<Vec<_>>();
    let mut metadata = json!({ "invocationId": run.id });
    if let Some((started_unix_s, seconds)) = times {
        metadata["startedOn"] = iso_time(started_unix_s).into();
        metadata["finishedOn"] = iso_time(end_of(started_unix_s, seconds)).into();
    }
    let root = Subject::new(crate::contents::RUN_ROOT, FileDigest::of(&run.root));
    let statement = json!({
        "_type": STATEMENT_TYPE,
        "subject": descriptors(subjects),
        "predicateType": PREDICATE_TYPE,
        "predicate": {
            "buildDefinition": {
                "buildType": BUILD_TYPE,
                "externalParameters": parameters,
                "resolvedDependencies": descriptors(dependencies),
            },
            "runDetails": {
                "builder": builder(run),
                "metadata": metadata,
                "byproducts": [root.descriptor()],
            },
        },
    });
    marf_cache::canonical_json(&statement)
}

/// Returns names and digests of what a statement is about; none if the bytes are no statement with SLSA provenance.
pub fn subjects_in(statement: &[u8]) -> Option<Vec<(String, Sha256)>> {
    let statement: Value = serde_json::from_slice(statement).ok()?;
    if statement["_type"] != STATEMENT_TYPE || statement["predicateType"] != PREDICATE_TYPE {
        return None;
    }
    let subject = |subject: &Value| {
        let digest = subject["digest"]["sha256"].as_str()?.parse().ok()?;
        Some((subject["name"].as_str()?.to_owned(), digest))
    };
    statement["subject"].as_array()?.iter().map(subject).collect()
}

/// Returns which program built it: its version and, in newer roots, its file.
fn builder(run: &Run) -> Value {
    let mut builder = json!({ "id": BUILDER, "version": { "marf": run.program } });
    if let Some(build) = &run.build {
        if let Some(commit) = &build.commit {
            builder["version"]["commit"] = commit.as_str().into();
        }
        builder["builderDependencies"] = json!([{
            "name": format!("marf for {} on {}", build.os, build.arch),
            "digest": { "blake3": build.blake3 },
        }]);
    }
    builder
}
