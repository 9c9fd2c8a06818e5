//! Selects the objects of the store for a crate, and their paths.

mod entries;
mod file;
mod items;
mod objects;
mod sets;

use std::collections::BTreeSet;

use marf_model::Run;

use crate::error::ExportError;

pub use entries::{Contents, ItemVerdict};
pub(crate) use file::is_plain;
pub use file::{Content, File, OBJECTS, Photos, Purpose, RUN_ROOT};
pub(crate) use objects::{object, read_action};
pub use sets::{leaves, rows};

/// Finds everything that belongs to a run. `file_name` returns the file name of an output that is one file.
///
/// # Errors
/// An object that cannot be read or is not what it should be, or a chosen photo that the run does not have.
pub fn contents(
    run: &Run<'_>,
    photos: &Photos,
    file_name: fn(&str) -> Option<&str>,
) -> Result<Contents, ExportError> {
    let mut contents = Contents::new(run, file_name)?;
    let chosen: Option<BTreeSet<&str>> = match photos {
        Photos::Chosen(ids) => Some(ids.iter().map(String::as_str).collect()),
        Photos::All => {
            for node in &run.nodes {
                let needs = run.needs(node)?.into_iter();
                needs.for_each(|digest| contents.add_object(digest, Purpose::Data));
            }
            None
        }
    };
    items::add_photos(&mut contents, run, chosen.as_ref())?;
    Ok(contents)
}
