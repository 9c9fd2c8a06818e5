//! Signed statements on who made a result, by what and from what.

use std::path::Path;

use marf_cache::Digest;
use marf_engine::Cancel;
use marf_export::dsse::Envelope;
use marf_export::{statement_on_node, statement_on_run, subjects_of};
use marf_model::{Run, RunNode};

use crate::choice::whole_run;
use crate::context::Context;
use crate::copies::object_of;
use crate::error::{Diagnostic, Error};
use crate::files::read_named;
use crate::outputs::file_name;
use crate::trust::signing_key;

/// A signed statement.
#[derive(Debug, Clone)]
pub struct Attestation {
    /// The envelope, one line.
    pub envelope: Vec<u8>,
    /// Id of the public key.
    pub key_id: String,
}

/// Signs a statement on a run, by default the newest whole one, with the private key in a file (PEM). `subject` is a node or a file with
/// the bytes of a result. By default, the statement covers all results of the run.
///
/// # Errors
/// A key, a run or a result that is not there.
pub fn attest(
    context: &Context,
    subject: Option<&str>,
    key: &Path,
    run: Option<u64>,
) -> Result<Attestation, Error> {
    let key = signing_key(key)?;
    let store = context.existing_store()?;
    let run = Run::new(&store, whole_run(context, &store, run)?)?;
    let statement = match subject {
        None => on_run(&run)?,
        Some(subject) => on_result(&run, subject, &context.cancel)?,
    };
    Ok(Attestation {
        envelope: Envelope::sign(&statement, &key).encode(),
        key_id: key.public().id().to_string(),
    })
}

/// Returns the statement on all results of the nodes that the pipeline names.
fn on_run(run: &Run<'_>) -> Result<Vec<u8>, Error> {
    let nodes = run.nodes.iter().filter(|node| !node.is_child());
    let subjects = subjects_of(run, nodes.flat_map(results))?;
    Ok(statement_on_run(run, &subjects)?)
}

/// Returns the statement on all results of a node, or on the one that a file holds.
fn on_result(run: &Run<'_>, subject: &str, cancel: &Cancel) -> Result<Vec<u8>, Error> {
    if let Some(node) = run.node(subject) {
        let subjects = subjects_of(run, results(node))?;
        return Ok(statement_on_node(run, node, &subjects)?);
    }
    let bytes = read_named(Path::new(subject), cancel, |error| {
        let message = format!("`{subject}` is no node of the run, and no file that can be read: {error}");
        Error::Usage(Diagnostic::new(message).hint("`marf status` lists the nodes"))
    })?;
    let digest = Digest::from_content(&object_of(bytes));
    let made_it = |node: &&RunNode| node.run.outputs.values().any(|output| output.digest == digest);
    let node = run.nodes.iter().find(made_it).ok_or_else(|| {
        let message = format!("{subject} holds no result of run {}", run.record.id);
        Error::Failed(Diagnostic::new(message).hint("name another run with --run. `marf log` lists all"))
    })?;
    let wanted = results(node).filter(|(_, found)| *found == digest).take(1);
    let subjects = subjects_of(run, wanted)?;
    Ok(statement_on_node(run, node, &subjects)?)
}

/// Returns the results of a node by name.
fn results(node: &RunNode) -> impl Iterator<Item = (String, Digest)> {
    let outputs = node.run.outputs.iter();
    outputs.map(|(name, output)| {
        let file = file_name(name).unwrap_or(name);
        (format!("{}/{file}", node.run.name), output.digest)
    })
}
