//! Signed statements on who made a result, by what and from what.

use std::path::{Path, PathBuf};

use marf_cache::{Digest, Store};
use marf_export::dsse::Envelope;
use marf_export::{Node, Run, statement_on_node, statement_on_run, subjects_of};

use super::handed;
use crate::context::Context;
use crate::copies::object_of;
use crate::error::{Diagnostic, Error};
use crate::trust::signing_key;

/// A result to sign for.
#[derive(Debug, Clone)]
pub struct AttestRequest {
    /// A node, or a file with the bytes of a result; none for all results of the run.
    pub subject: Option<String>,
    /// File of the private key, PEM.
    pub key: PathBuf,
    /// Number of the run; none for the last one.
    pub run: Option<u64>,
}

/// A signed statement.
#[derive(Debug, Clone)]
pub struct Attestation {
    /// The envelope, one line.
    pub envelope: Vec<u8>,
    /// Id of the public key.
    pub key_id: String,
}

/// Signs a statement.
///
/// # Errors
/// A key, a run or a result that is not there.
pub fn attest(context: &Context, request: &AttestRequest) -> Result<Attestation, Error> {
    let key = signing_key(&request.key)?;
    let store = context.existing_store()?;
    let handed = handed::load(&store, request.run)?;
    let statement = match &request.subject {
        None => on_run(&handed, &store)?,
        Some(subject) => on_result(&handed, &store, subject)?,
    };
    Ok(Attestation {
        envelope: Envelope::sign(&statement, &key).encode(),
        key_id: key.public().id().to_string(),
    })
}

/// Returns the statement on all results of the nodes that the pipeline names.
fn on_run(handed: &Run, store: &Store) -> Result<Vec<u8>, Error> {
    let nodes = handed.nodes.iter().filter(|node| node.parent.is_none());
    let read = handed::reader(store);
    let subjects = subjects_of(nodes.flat_map(results), &read)?;
    Ok(statement_on_run(handed, &subjects, &read)?)
}

/// Returns the statement on all results of a node, or on the one that a file holds.
fn on_result(handed: &Run, store: &Store, subject: &str) -> Result<Vec<u8>, Error> {
    let read = handed::reader(store);
    if let Ok(node) = handed.node(subject) {
        let subjects = subjects_of(results(node), &read)?;
        return Ok(statement_on_node(handed, node, &subjects, &read)?);
    }
    let bytes = std::fs::read(Path::new(subject)).map_err(|error| {
        let message = format!("`{subject}` is no node of the run, and no file that can be read: {error}");
        Error::Usage(Diagnostic::new(message).hint("`marf status` lists the nodes"))
    })?;
    let digest = Digest::of(&object_of(bytes));
    let made_it = |node: &&Node| node.outputs.values().any(|output| output.digest == digest);
    let node = handed.nodes.iter().find(made_it).ok_or_else(|| {
        let message = format!("{subject} holds no result of run {}", handed.id);
        Error::Failed(Diagnostic::new(message).hint("name another run with --run; `marf log` lists them"))
    })?;
    let wanted = results(node).filter(|(_, found)| *found == digest).take(1);
    let subjects = subjects_of(wanted, &read)?;
    Ok(statement_on_node(handed, node, &subjects, &read)?)
}

/// Returns the results of a node by name.
fn results(node: &Node) -> impl Iterator<Item = (String, Digest)> {
    let outputs = node.outputs.iter();
    outputs.map(|(name, output)| {
        let file = output.file.as_ref().unwrap_or(name);
        (format!("{}/{file}", node.name), output.digest)
    })
}
