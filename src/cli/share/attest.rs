//! `marf export attest`.

use std::path::Path;

use marf_cache::{Digest, Store};
use marf_engine::Cancel;
use marf_export::dsse::Envelope;
use marf_export::{Node, Run, statement_on_node, statement_on_run, subjects_of};

use super::super::args::Global;
use super::super::copies::object_of;
use super::super::error::{CliError, Diagnostic};
use super::super::files;
use super::super::session::existing_store;
use super::{AttestArgs, run};
use crate::cli::trust::signing_key;
use crate::terminal::{eprint_line, print_line};

pub(super) fn attest(global: &Global, args: &AttestArgs, cancel: &Cancel) -> Result<(), CliError> {
    let key = signing_key(&args.key)?;
    let store = existing_store(global, cancel)?;
    let handed = run::load(&store, args.run)?;
    let statement = match &args.of {
        None => on_run(&handed, &store)?,
        Some(of) => on_result(&handed, &store, of)?,
    };
    let line = Envelope::sign(&statement, &key).encode();
    match &args.out {
        Some(out) => files::write(out, &line)?,
        None => print_line(String::from_utf8_lossy(&line).trim_end()),
    }
    eprint_line(&format!("signed by key {}", key.public().id()));
    Ok(())
}

/// Returns the statement on all results of the nodes that the pipeline names.
fn on_run(handed: &Run, store: &Store) -> Result<Vec<u8>, CliError> {
    let nodes = handed.nodes.iter().filter(|node| node.parent.is_none());
    let read = run::reader(store);
    let subjects = subjects_of(nodes.flat_map(results), &read)?;
    Ok(statement_on_run(handed, &subjects, &read)?)
}

/// Returns the statement on all results of a node, or on the one that a file holds.
fn on_result(handed: &Run, store: &Store, of: &str) -> Result<Vec<u8>, CliError> {
    let read = run::reader(store);
    if let Ok(node) = handed.node(of) {
        let subjects = subjects_of(results(node), &read)?;
        return Ok(statement_on_node(handed, node, &subjects, &read)?);
    }
    let bytes = std::fs::read(Path::new(of)).map_err(|error| {
        let message = format!("`{of}` is no node of the run, and no file that can be read: {error}");
        CliError::Usage(Diagnostic::new(message).hint("`marf status` lists the nodes"))
    })?;
    let digest = Digest::of(&object_of(bytes));
    let made_it = |node: &&Node| node.outputs.values().any(|output| output.digest == digest);
    let node = handed.nodes.iter().find(made_it).ok_or_else(|| {
        let message = format!("{of} holds no result of run {}", handed.id);
        CliError::Failed(Diagnostic::new(message).hint("name another run with --run; `marf log` lists them"))
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
