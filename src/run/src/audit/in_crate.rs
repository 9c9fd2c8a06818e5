//! Who made a file, by a crate alone.

use std::path::Path;

use marf_cache::Digest;
use marf_engine::Cancel;
use marf_export::verify::Trace;
use marf_provenance::stamp::Stamp;
use serde::Serialize;

use super::file::file_bytes;
use crate::copies::object_of;
use crate::error::{Answer, Diagnostic, Error};
use crate::export::{open_crate, verify_crate};

/// The origin of a file by the run of a crate.
#[derive(Debug, Serialize)]
pub struct CrateTrace {
    /// Whole: any other answer is an error of [`trace`].
    pub answer: Answer,
    /// The origin.
    #[serde(flatten)]
    pub trace: Trace,
}

/// Traces a file in the run of a crate.
///
/// # Errors
/// A file or a crate that cannot be read. Also the answers "altered", for the file or the crate, and "not ours".
pub fn trace(file: &Path, folder: &Path, cancel: &Cancel) -> Result<CrateTrace, Error> {
    let bytes = file_bytes(file, cancel)?;
    let answered = |answer, message: String| Error::Answered(answer, Diagnostic::new(message));
    verify_crate(folder, cancel)?;
    let named = Stamp::take_from(&bytes).map(|(_, stamp)| stamp.object);
    let digest = Digest::from_content(&object_of(bytes));
    if named.is_some_and(|object| object != digest) {
        let message = format!("{} is not what its mark says: it was altered", file.display());
        return Err(answered(Answer::Altered, message));
    }
    let trace = open_crate(folder, cancel)?.trace(&digest);
    let trace =
        trace.map_err(|cause| answered(Answer::Incomplete, format!("{}: {cause}", folder.display())))?;
    let trace = trace.ok_or_else(|| {
        let (file, folder) = (file.display(), folder.display());
        answered(
            Answer::NotOurs,
            format!("{file} has the bytes of nothing that the run of {folder} made: it is another file, or it was altered"),
        )
    })?;
    Ok(CrateTrace {
        answer: Answer::Whole,
        trace,
    })
}
