//! The run that is handed out, read from the store.

use std::sync::Arc;

use marf_cache::{Digest, Store, read_digest_list};
use marf_export::Run;
use marf_provenance::lineage::{Lineage, NodeLineage};
use marf_provenance::product;
use marf_stage::PHOTOS;

use crate::error::{Diagnostic, Error};
use crate::outputs::file_name;
use crate::session::is_aside;

/// Reads a run by number, or the last one that is no export, with the names of its files and how its results were made.
///
/// # Errors
/// A run that is not there or did not end well, or a store that cannot be read.
pub fn load(store: &Store, number: Option<u64>) -> Result<Run, Error> {
    let number = match number {
        Some(number) => number,
        None => {
            let is_own = |number: &u64| !marf_engine::run_of(store, *number).is_ok_and(|run| is_aside(&run));
            store
                .run_numbers()?
                .into_iter()
                .rev()
                .find(is_own)
                .ok_or_else(no_run)?
        }
    };
    let mut run = Run::of(store.run(number)?)?;
    let lineage = Lineage::open(store, number)?;
    for node in &mut run.nodes {
        for (name, output) in &mut node.outputs {
            output.file = file_name(name).map(str::to_owned);
        }
        if let Some(known) = lineage.node(&node.name) {
            node.origins = origins(store, known)?;
            let made = known.record.as_ref().map(|record| &record.metadata);
            node.needs = needs(store, known)?;
            node.made_by = made.map(|made| format!("{} on {}", made.program, made.device));
        }
    }
    Ok(run)
}

/// Returns the lists of the files that a source read of its archive, sol by sol; none for other nodes.
fn origins(store: &Store, node: &NodeLineage) -> Result<Vec<Digest>, Error> {
    if !node.is_source() {
        return Ok(Vec::new());
    }
    let mut origins = Vec::new();
    for part in product::parts(store, node)? {
        origins.extend(store.record(&part.key)?.and_then(|record| record.origins));
    }
    Ok(origins)
}

/// Returns what a node that makes no set of photos stored beside its outputs; the rows of a set name their objects.
fn needs(store: &Store, node: &NodeLineage) -> Result<Vec<Digest>, Error> {
    let record = node.record.as_ref();
    let list = record.filter(|record| !record.outputs.contains_key(PHOTOS));
    let Some(list) = list.and_then(|record| record.needs) else {
        return Ok(Vec::new());
    };
    let unreadable = || Error::failed(format!("the list of what `{}` needs is damaged", node.run.name));
    read_digest_list(&store.get(&list)?).ok_or_else(unreadable)
}

fn no_run() -> Error {
    Error::Failed(Diagnostic::new("there is no run yet").hint("`marf run` makes one"))
}

/// Returns a reader of objects for exports.
pub fn reader(store: &Store) -> impl Fn(&Digest) -> Result<Arc<[u8]>, String> + '_ {
    |digest| store.get(digest).map_err(|error| error.to_string())
}
