//! Checks exports, without a store.

use std::path::{Path, PathBuf};

use marf_engine::Cancel;
use marf_export::dsse::Envelope;
use marf_export::subjects_in;
use marf_export::verify::{OpenCrate, OpenError, Report, verify};
use marf_keys::PublicKey;

use crate::copies::object_of;
use crate::error::{Diagnostic, Error};
use crate::trust::public_key;

/// An export to check.
#[derive(Debug, Clone)]
pub struct VerifyRequest {
    /// The folder of a crate, or the file of a statement.
    pub path: PathBuf,
    /// File of the public key that its signature is checked with, PEM.
    pub key: Option<PathBuf>,
    /// Files that the statement must be about.
    pub subjects: Vec<PathBuf>,
}

/// What was checked.
#[derive(Debug)]
pub enum VerifyResult {
    /// A crate, which may have faults: see [`without_faults`].
    Crate(Report),
    /// A statement that is signed by the key.
    Statement {
        /// The files of the request by their names in the statement.
        found: Vec<(PathBuf, String)>,
        /// How many files the statement is about.
        subjects: usize,
    },
}

/// Checks a crate or a statement.
///
/// # Errors
/// Something that is neither; a statement that does not hold.
pub fn verify_path(request: &VerifyRequest, cancel: &Cancel) -> Result<VerifyResult, Error> {
    let key = request.key.as_deref().map(public_key).transpose()?;
    if request.path.is_file() {
        let key = key.ok_or_else(|| {
            Error::Usage(
                Diagnostic::new(
                    "a statement is worth what its signature is worth: name a public key with --key",
                )
                .hint("`openssl pkey -in KEY.pem -pubout -out PUB.pem` writes it"),
            )
        })?;
        return verify_statement(request, &key);
    }
    if !request.subjects.is_empty() {
        return Err(Error::usage("--subject goes with a statement, not with a crate"));
    }
    let report = verify(&request.path, key.as_ref(), cancel).map_err(open_error)?;
    Ok(VerifyResult::Crate(report))
}

/// Checks a crate, and prints nothing.
///
/// # Errors
/// A folder that is no crate; a crate that does not hold.
pub fn verify_crate(folder: &Path, cancel: &Cancel) -> Result<(), Error> {
    without_faults(folder, &verify(folder, None, cancel).map_err(open_error)?)
}

/// Opens a crate.
///
/// # Errors
/// A folder that is no crate, or one of a newer form.
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
            Diagnostic::new(format!("{} does not hold; faults: {faults}", folder.display()))
                .hint("ask whoever made it for another copy; trust nothing in this one"),
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
fn verify_statement(request: &VerifyRequest, key: &PublicKey) -> Result<VerifyResult, Error> {
    let refuse =
        |error: String| Error::altered(Diagnostic::new(format!("{}: {error}", request.path.display())));
    let bytes = std::fs::read(&request.path).map_err(|error| refuse(error.to_string()))?;
    let envelope = Envelope::decode(&bytes)
        .map_err(|error| Error::usage(format!("{}: {error}", request.path.display())))?;
    let statement = envelope.verify(key).map_err(|error| refuse(error.to_string()))?;
    let subjects = subjects_in(&statement).ok_or_else(|| refuse("it is no in-toto statement".to_owned()))?;
    let mut found = Vec::new();
    for file in &request.subjects {
        let bytes = std::fs::read(file)
            .map_err(|error| Error::usage(format!("{} cannot be read: {error}", file.display())))?;
        let sha256 = marf_cache::Sha256::from_content(&object_of(bytes));
        let subject = subjects.iter().find(|(_, digest)| *digest == sha256);
        let (name, _) = subject.ok_or_else(|| refuse(format!("it is not about {}", file.display())))?;
        found.push((file.clone(), name.to_string()));
    }
    Ok(VerifyResult::Statement {
        found,
        subjects: subjects.len(),
    })
}
