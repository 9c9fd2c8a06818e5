//! The field in a file, known by its content.

use std::path::Path;

use marf_cache::{Digest, Store};
use marf_engine::OutputName;
use marf_provenance::find::{Place, find};
use marf_schema::output::WEIGHTS;

use crate::context::Context;
use crate::copies::object_of;
use crate::error::{Diagnostic, Error};
use crate::files::read_named;

/// The node that gave a field, and the runs that have it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldMaker {
    /// The node.
    pub node: String,
    /// Numbers of the runs.
    pub runs: Vec<u64>,
}

/// Returns the node whose field a file contains, and the runs of the store that have it. `number` is the run that the user named.
///
/// # Errors
/// A file that cannot be read, or that is not the field of any node in these runs.
pub fn made_by(
    context: &Context,
    store: &Store,
    file: &Path,
    number: Option<u64>,
) -> Result<FieldMaker, Error> {
    let bytes = read_named(file, &context.cancel, |error| {
        Error::usage(format!("--field {}: cannot be read: {error}", file.display()))
    })?;
    let runs = marf_engine::runs(store, context.warnings())?;
    let makers = find(store, &runs, &Digest::from_content(&object_of(bytes)))?;
    let of_pipeline = makers.into_iter().find_map(|maker| match maker.place {
        // What is below another node is a trial or a retraining, which no pipeline names.
        Place::Output(OutputName { node, output }) if output == WEIGHTS && !node.contains('/') => {
            let has_named = number.is_none_or(|number| maker.runs.contains(&number));
            let runs = maker.runs;
            has_named.then_some(FieldMaker { node, runs })
        }
        _ => None,
    });
    of_pipeline.ok_or_else(|| {
        let of = number.map_or("a run of this store".to_owned(), |number| format!("run {number}"));
        let message = format!("--field {}: no node of {of} gave this field", file.display());
        let hint = "take weights.safetensors of `out/train`, or name the store with --store. `marf audit FILE` identifies a file";
        Error::Usage(Diagnostic::new(message).hint(hint))
    })
}
