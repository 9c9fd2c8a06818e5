//! Checks exports, without a store.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use marf_cache::file::{FileKind, Links, read};
use marf_engine::Cancel;
use marf_export::dsse::Envelope;
use marf_export::subjects_in;
use marf_export::verify::{OpenCrate, OpenError, Report, verify};
use marf_keys::PublicKey;
use serde::Serialize;

use crate::copies::object_of;
use crate::error::{Diagnostic, Error};
use crate::files::read_named;
use crate::trust::public_key;

/// What was checked.
#[derive(Debug)]
pub enum VerifyResult {
    /// A crate, which may have faults: see [`without_faults`].
    Crate(Report),
    /// A statement that is signed by the key.
    Statement(Statement),
}

/// A statement that is signed by a key.
#[derive(Debug, Serialize)]
pub struct Statement {
    /// The files that it must be about, by their names in it.
    pub found: BTreeMap<String, PathBuf>,
    /// How many files it is about.
    pub subjects: usize,
}

/// Verifies the folder of a crate or the file of a statement, and its signature with the public key in a file (PEM). `subjects` are files
/// that the statement must cover.
///
/// # Errors
/// A path that is neither, or a statement that does not hold.
pub fn verify_path(
    path: &Path,
    key: Option<&Path>,
    subjects: &[PathBuf],
    cancel: &Cancel,
) -> Result<VerifyResult, Error> {
    let key = key.map(public_key).transpose()?;
    if path.is_file() {
        let key = key.ok_or_else(|| {
            Error::Usage(
                Diagnostic::new(
                    "a statement is worth what its signature is worth: name a public key with --key",
                )
                .hint("`openssl pkey -in KEY.pem -pubout -out PUB.pem` writes it"),
            )
        })?;
        return verify_statement(path, &key, subjects, cancel).map(VerifyResult::Statement);
    }
    if !subjects.is_empty() {
        return Err(Error::usage("--subject goes with a statement, not with a crate"));
    }
    let report = verify(path, key.as_ref(), cancel).map_err(open_error)?;
    Ok(VerifyResult::Crate(report))
}

/// Verifies a crate, and prints nothing.
///
/// # Errors
/// A folder that is not a crate, or a crate that does not hold.
pub fn verify_crate(folder: &Path, cancel: &Cancel) -> Result<(), Error> {
    without_faults(folder, &verify(folder, None, cancel).map_err(open_error)?)
}

/// Opens a crate.
///
/// # Errors
/// A folder that is not a crate, or one of a newer form.
pub fn open_crate(folder: &Path, cancel: &Cancel) -> Result<OpenCrate, Error> {
    OpenCrate::open(folder, cancel).map_err(open_error)
}

/// Returns an error if a report has faults.
///
/// # Errors
/// [`Error::Answered`] with the number of the faults.
pub fn without_faults(folder: &Path, report: &Report) -> Result<(), Error> {
    match report.faults.len() {
        0 => Ok(()),
        faults => Err(Error::altered(
            Diagnostic::new(format!("{} does not hold (faults: {faults})", folder.display()))
                .hint("ask whoever made it for another copy. Trust nothing in this one"),
        )),
    }
}

fn open_error(error: OpenError) -> Error {
    let diagnostic = Diagnostic::new(error.to_string());
    match error {
        OpenError::Newer { .. } => Error::Newer(diagnostic.hint("a newer marf reads it")),
        OpenError::NoCrate { .. } | OpenError::Foreign { .. } => {
            Error::Usage(diagnostic.hint("`marf export crate` writes crates"))
        }
        OpenError::BadRun { .. } => Error::altered(diagnostic),
        OpenError::Stopped => Error::Interrupted,
    }
}

/// Checks a statement: its signature, and that it is about the files named.
fn verify_statement(
    path: &Path,
    key: &PublicKey,
    files: &[PathBuf],
    cancel: &Cancel,
) -> Result<Statement, Error> {
    let refuse = |error: String| Error::altered(Diagnostic::new(format!("{}: {error}", path.display())));
    let bytes = read(path, FileKind::Document, Links::Followed).map_err(|error| refuse(error.to_string()))?;
    let envelope =
        Envelope::decode(&bytes).map_err(|error| Error::usage(format!("{}: {error}", path.display())))?;
    let statement = envelope.verify(key).map_err(|error| refuse(error.to_string()))?;
    let subjects =
        subjects_in(&statement).ok_or_else(|| refuse("it is not an in-toto statement".to_owned()))?;
    let mut found = BTreeMap::new();
    for file in files {
        let bytes = read_named(file, cancel, |error| {
            Error::usage(format!("{} cannot be read: {error}", file.display()))
        })?;
        let sha256 = marf_cache::Sha256::from_content(&object_of(bytes));
        let subject = subjects.iter().find(|(_, digest)| *digest == sha256);
        let (name, _) = subject.ok_or_else(|| refuse(format!("it is not about {}", file.display())))?;
        found.insert(name.to_string(), file.clone());
    }
    Ok(Statement {
        found,
        subjects: subjects.len(),
    })
}
