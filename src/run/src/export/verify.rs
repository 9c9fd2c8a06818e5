//! Checks exports, without a store.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use marf_cache::file::{FileKind, Links, read};
use marf_engine::Cancel;
use marf_export::dsse::{Envelope, EnvelopeError};
use marf_export::subjects_in;
use marf_export::verify::{OpenCrate, OpenError, Report, Signature, verify};
use serde::Serialize;

use crate::copies::object_of;
use crate::error::{Answer, Diagnostic, Error};
use crate::files::read_named;
use crate::trust::public_key;

/// What was checked.
#[derive(Debug)]
pub enum VerifyResult {
    /// A crate.
    Crate(CrateCheck),
    /// A statement that is signed by the key.
    Statement(Statement),
}

/// The check of a crate.
#[derive(Debug, Serialize)]
pub struct CrateCheck {
    /// Whole, altered, or not signed with the given key.
    pub answer: Answer,
    /// What was found.
    #[serde(flatten)]
    pub report: Report,
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
/// A path that is neither, or a statement that was altered or is not signed with the key.
pub fn verify_path(
    path: &Path,
    key: Option<&Path>,
    subjects: &[PathBuf],
    cancel: &Cancel,
) -> Result<VerifyResult, Error> {
    let public = key.map(public_key).transpose()?;
    if path.is_file() {
        let envelope = read_statement(path)?;
        let (Some(public), Some(key)) = (public, key) else {
            let message = format!(
                "only a signature makes {} trustworthy: name a public key with --key",
                path.display()
            );
            let hint =
                "ask the author for the key. `openssl pkey -in KEY.pem -pubout -out PUB.pem` writes it";
            return Err(Error::Usage(Diagnostic::new(message).hint(hint)));
        };
        let statement = envelope.verify(&public).map_err(|error| match error {
            EnvelopeError::NotSigned if !envelope.names(&public) => {
                let message = format!("{} is not signed with {}", path.display(), key.display());
                Error::Answered(Answer::NotSigned, Diagnostic::new(message))
            }
            error => refused(path, &error),
        })?;
        return Ok(VerifyResult::Statement(check_statement(
            path, &statement, subjects, cancel,
        )?));
    }
    if !subjects.is_empty() {
        return Err(Error::usage("--subject goes with a statement, not with a crate"));
    }
    let report = verify(path, public.as_ref(), cancel).map_err(open_error)?;
    let answer = answer(&report);
    Ok(VerifyResult::Crate(CrateCheck { answer, report }))
}

/// Returns the first answer that applies: altered, not signed.
fn answer(report: &Report) -> Answer {
    match report.signature {
        _ if !report.faults.is_empty() => Answer::Altered,
        Signature::Missing | Signature::OtherKey => Answer::NotSigned,
        Signature::Bad => Answer::Altered,
        Signature::None | Signature::NotChecked | Signature::Good => Answer::Whole,
    }
}

/// Verifies a crate, and prints nothing.
///
/// # Errors
/// A folder that is not a crate, or a crate that does not hold.
pub fn verify_crate(folder: &Path, cancel: &Cancel) -> Result<(), Error> {
    let report = verify(folder, None, cancel).map_err(open_error)?;
    let answer = answer(&report);
    CrateCheck { answer, report }.is_whole(folder)
}

/// Opens a crate.
///
/// # Errors
/// A folder that is not a crate, or one of a newer form.
pub fn open_crate(folder: &Path, cancel: &Cancel) -> Result<OpenCrate, Error> {
    OpenCrate::open(folder, cancel).map_err(open_error)
}

impl CrateCheck {
    /// Returns an error unless the crate is whole, and signed with the key if one was given.
    ///
    /// # Errors
    /// [`Error::Answered`] with the answer in a sentence.
    pub fn is_whole(&self, folder: &Path) -> Result<(), Error> {
        let folder = folder.display();
        let (message, hint) = match self.answer {
            Answer::Altered => (
                format!("{folder} is not intact (faults: {})", self.report.faults.len()),
                "ask the author for another copy. Trust nothing in this one",
            ),
            Answer::NotSigned => (
                format!("{folder} is not signed with this key"),
                "ask the author for a signed crate, or for the key that signed this one",
            ),
            _ => return Ok(()),
        };
        Err(Error::Answered(self.answer, Diagnostic::new(message).hint(hint)))
    }
}

fn open_error(error: OpenError) -> Error {
    let diagnostic = Diagnostic::new(error.to_string());
    match error {
        OpenError::Newer { .. } => Error::Newer(diagnostic.hint("a newer marf reads it")),
        OpenError::NoFolder { .. } | OpenError::NoCrate { .. } | OpenError::Foreign { .. } => {
            Error::Usage(diagnostic.hint("name the folder that `marf export crate` wrote. If it is that folder, it is damaged: ask the author for another copy"))
        }
        OpenError::BadRun { .. } => Error::altered(diagnostic),
        OpenError::Stopped => Error::Interrupted,
    }
}

/// Reads the file of a statement, and believes nothing in it.
fn read_statement(path: &Path) -> Result<Envelope, Error> {
    let file = path.display();
    let bytes = read(path, FileKind::Document, Links::Followed)
        .map_err(|error| Error::failed(format!("cannot read {file}: {error}")))?;
    Envelope::decode(&bytes).map_err(|_| {
        let message = format!("{file} is neither the folder of a crate nor a signed statement");
        let hint = format!(
            "`verify` checks what `export crate` or `export attest` wrote. `marf audit {file}` traces any other file"
        );
        Error::Usage(Diagnostic::new(message).hint(hint))
    })
}

fn refused(path: &Path, error: &dyn std::fmt::Display) -> Error {
    Error::altered(Diagnostic::new(format!("{}: {error}", path.display())))
}

/// Checks that a signed statement is about the files named.
fn check_statement(
    path: &Path,
    statement: &[u8],
    files: &[PathBuf],
    cancel: &Cancel,
) -> Result<Statement, Error> {
    let subjects = subjects_in(statement).ok_or_else(|| refused(path, &"it is not an in-toto statement"))?;
    let mut found = BTreeMap::new();
    for file in files {
        let bytes = read_named(file, cancel, |error| {
            Error::usage(format!("{} cannot be read: {error}", file.display()))
        })?;
        let sha256 = marf_cache::Sha256::from_content(&object_of(bytes));
        let subject = subjects.iter().find(|(_, digest)| *digest == sha256);
        let (name, _) =
            subject.ok_or_else(|| refused(path, &format!("it is not about {}", file.display())))?;
        found.insert(name.to_string(), file.clone());
    }
    Ok(Statement {
        found,
        subjects: subjects.len(),
    })
}
