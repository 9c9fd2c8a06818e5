//! in-toto statements, version 1, with SLSA provenance, version 1: who made these bytes, from which.

use std::collections::BTreeSet;

use marf_cache::{Digest, Sha256};
use marf_engine::RunRecord;
use marf_model::{Run, RunNode};
use serde_json::{Value, json};

use crate::bag::FileDigest;
use crate::contents::{object, read_action};
use crate::error::ExportError;
use crate::run::check_finished;
use crate::time::{end_of, known_time};

/// Type of a statement.
const STATEMENT_TYPE: &str = "https://in-toto.io/Statement/v1";
/// Type of what it says.
const PREDICATE_TYPE: &str = "https://slsa.dev/provenance/v1";
/// How the program builds. docs/design/crates-and-audit.md describes the parameters.
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
    run: &Run<'_>,
    node: &RunNode,
    subjects: &[Subject],
) -> Result<Vec<u8>, ExportError> {
    check_finished(&run.record)?;
    let action = read_action(run, node)?;
    let mut dependencies = documents(run)?;
    let inputs = action.inputs.iter();
    let inputs = inputs.map(|(name, digest)| (format!("input {name}"), *digest));
    dependencies.extend(subjects_of(run, inputs.chain(origins(run, node)?))?);
    let metadata = metadata(run, node.run.started_unix_s, node.run.seconds);
    let parameters = json!({
        "pipeline": run.record.pipeline,
        "node": node.run.name,
        "key": node.run.key,
        "action": action,
    });
    encode(run, parameters, &dependencies, metadata, subjects)
}

/// Returns the statement that a run made these bytes.
///
/// # Errors
/// An object that cannot be read.
pub fn statement_on_run(run: &Run<'_>, subjects: &[Subject]) -> Result<Vec<u8>, ExportError> {
    check_finished(&run.record)?;
    let outputs = run.record.nodes.iter().flat_map(|node| node.outputs.values());
    let made: BTreeSet<Digest> = outputs.map(|output| output.digest).collect();
    let mut dependencies = documents(run)?;
    for node in &run.nodes {
        let inputs = read_action(run, node)?.inputs.into_iter();
        let foreign = inputs.filter(|(_, digest)| !made.contains(digest));
        let named = foreign.map(|(name, digest)| (format!("{} input {name}", node.run.name), digest));
        dependencies.extend(subjects_of(run, named.chain(origins(run, node)?))?);
    }
    let parameters = json!({ "pipeline": run.record.pipeline, "command": run.record.command });
    let metadata = metadata(run, Some(run.record.started_unix_s), run.record.seconds);
    encode(run, parameters, &dependencies, metadata, subjects)
}

fn documents(run: &Run<'_>) -> Result<Vec<Subject>, ExportError> {
    let documents = run.record.documents.iter();
    subjects_of(run, documents.map(|(name, output)| (name.clone(), output.digest)))
}

fn origins(run: &Run<'_>, node: &RunNode) -> Result<impl Iterator<Item = (String, Digest)>, ExportError> {
    let name = node.run.name.clone();
    let lists = (0..).zip(run.origins(node)?);
    Ok(lists.map(move |(number, digest)| (format!("{name} read, list {number}"), digest)))
}

/// Reads objects and returns them with their digests.
///
/// # Errors
/// An object that cannot be read.
pub fn subjects_of(
    run: &Run<'_>,
    named: impl Iterator<Item = (String, Digest)>,
) -> Result<Vec<Subject>, ExportError> {
    let mut subjects = Vec::new();
    for (name, digest) in named {
        let bytes = object(run, &digest, || name.clone())?;
        subjects.push(Subject::new(name, FileDigest::new(&bytes)));
    }
    Ok(subjects)
}

/// Returns which run it was, and when the work began and ended if that is known.
fn metadata(run: &Run<'_>, started_unix_s: Option<u64>, seconds: f64) -> Value {
    let mut metadata = json!({ "invocationId": run.record.id });
    let started_unix_s = started_unix_s.unwrap_or(0);
    if let Some(started) = known_time(started_unix_s) {
        metadata["startedOn"] = started.into();
        metadata["finishedOn"] = known_time(end_of(started_unix_s, seconds)).into();
    }
    metadata
}

fn encode(
    run: &Run<'_>,
    parameters: Value,
    dependencies: &[Subject],
    metadata: Value,
    subjects: &[Subject],
) -> Result<Vec<u8>, ExportError> {
    let descriptors = |subjects: &[Subject]| subjects.iter().map(Subject::descriptor).collect::<Vec<_>>();
    let root = Subject::new(crate::contents::RUN_ROOT, FileDigest::new(&run.root()?));
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
                "builder": builder(&run.record),
                "metadata": metadata,
                "byproducts": [root.descriptor()],
            },
        },
    });
    Ok(marf_cache::canonical_json(&statement))
}

/// Returns names and digests of the subjects of a statement. `None` if the bytes are not a statement with
/// SLSA provenance.
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

/// Returns which program built it: its version and its file, where that is known.
fn builder(run: &RunRecord) -> Value {
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
