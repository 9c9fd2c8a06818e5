//! Who made a file, from which bytes.

use std::path::{Path, PathBuf};

use marf_engine::Cancel;
use marf_model::Run;
use marf_provenance::verify::{self, Verified};
use serde::Serialize;

use super::changed::{self, Changed};
use super::from::{ProductUses, uses};
use super::identity::{Identity, identify};
use super::lineage::{Detail, Origin, origin_of};
use crate::context::Context;
use crate::error::{Answer, Diagnostic, Error};
use crate::files::read_named;

/// A file to trace.
#[derive(Debug, Clone)]
pub struct AuditRequest {
    /// File to trace.
    pub file: PathBuf,
    /// Whether everything that it was made from is read and compared with its digests.
    pub verify: bool,
    /// How much of its lineage is listed.
    pub detail: Detail,
}

/// Who made a file.
#[derive(Debug, Serialize)]
pub struct AuditReport {
    /// The file.
    pub file: PathBuf,
    /// The answer in a word.
    pub answer: Answer,
    /// Identity of the file.
    #[serde(flatten)]
    pub identity: Identity,
    /// Lineage of the file, one for each maker.
    pub lineage: Vec<Origin>,
    /// The runs and nodes that a file of an archive went into. Absent for a file that marf made.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uses: Option<ProductUses>,
    /// What was verified.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub verified: Option<Verified>,
    /// Files of archives that have changed since.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub changed: Vec<Changed>,
}

/// Traces a file.
///
/// # Errors
/// A file or a store that cannot be read, the wish to stop.
pub fn audit(context: &Context, request: &AuditRequest) -> Result<AuditReport, Error> {
    let file = &request.file;
    let bytes = file_bytes(file, &context.cancel)?;
    let store = context.existing_store()?;
    let check = request.verify.then(|| verify::check(&store)).transpose()?;
    let runs = marf_engine::runs(&store, context.warnings())?;
    let identity = identify(&store, &runs, &bytes)?;
    let (mut lineage, mut changed) = (Vec::new(), Vec::new());
    let mut verified = check.as_ref().map(Verified::from_files);
    for maker in identity.makers() {
        let number = maker.made_in.or(maker.runs.first().copied());
        let Some(run) = runs.iter().find(|run| Some(run.number) == number) else {
            continue;
        };
        let whole = Run::new(&store, run.clone())?;
        let nodes = match maker.place.node() {
            Some(node) => whole.upstream(node),
            None => whole.nodes.iter().collect(),
        };
        lineage.push(origin_of(&whole, maker, &nodes, request.detail)?);
        if let Some(check) = &check {
            let found = verify::verify(&whole, &nodes, check)?;
            verified = verified.map(|before| before.and(found));
            changed.extend(changed::since(context, &whole, &nodes)?);
        }
    }
    let uses = match &identity {
        Identity::Whole { object, .. } if identity.is_input() => Some(uses(context, &object.to_string())?),
        _ => None,
    };
    Ok(AuditReport {
        uses,
        file: file.clone(),
        answer: answer(&identity, &lineage, verified.as_ref(), &changed),
        identity,
        lineage,
        verified,
        changed,
    })
}

/// Reads a file to trace.
///
/// # Errors
/// A folder, or a file that cannot be read.
pub(super) fn file_bytes(file: &Path, cancel: &Cancel) -> Result<Vec<u8>, Error> {
    if file.is_dir() {
        let folder = file.display();
        let diagnostic = Diagnostic::new(format!("{folder} is a folder, and `audit` traces one file"));
        return Err(Error::Usage(diagnostic.hint(format!(
            "name a file in it. `marf verify {folder}` checks the folder of a crate"
        ))));
    }
    read_named(file, cancel, |error| {
        Error::failed(format!("cannot read {}: {error}", file.display()))
    })
}

/// Returns the first answer that applies: altered, incomplete, changed.
fn answer(
    identity: &Identity,
    lineages: &[Origin],
    verified: Option<&Verified>,
    changed: &[Changed],
) -> Answer {
    let has_faults = verified.is_some_and(|verified| !verified.faults.is_empty());
    let has_lost = verified.is_some_and(|verified| !verified.missing.is_empty());
    match identity {
        _ if has_faults => Answer::Altered,
        Identity::NotOurs { .. } => Answer::NotOurs,
        Identity::Altered { .. } => Answer::Altered,
        Identity::Elsewhere { .. } => Answer::Incomplete,
        Identity::Whole { .. } if has_lost || lineages.iter().any(Origin::is_incomplete) => {
            Answer::Incomplete
        }
        Identity::Whole { .. } if !changed.is_empty() => Answer::Changed,
        Identity::Whole { .. } => Answer::Whole,
    }
}

/// Returns an error unless a file is whole.
///
/// # Errors
/// [`Error::Answered`] with the answer in a sentence.
pub fn is_whole(answer: Answer, file: &Path) -> Result<(), Error> {
    let file = file.display();
    let said = |message: String| Err(Error::Answered(answer, Diagnostic::new(message)));
    match answer {
        Answer::NotOurs => said(format!("{file} is not a file of this store")),
        Answer::Altered => said(format!("{file}, or something that it was made from, was altered")),
        Answer::Incomplete => said(format!(
            "{file}, or something that it was made from, is not in this store"
        )),
        Answer::Changed => said(format!("an archive has changed a file that {file} was made from")),
        // The others are answers of `verify` and `replay`.
        _ => Ok(()),
    }
}
