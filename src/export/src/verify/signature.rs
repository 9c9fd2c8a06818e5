//! The signature of a crate.

use super::open::OpenCrate;
use crate::bag::MANIFEST;
use crate::contents::RUN_ROOT;
use crate::crates::ATTESTATION;
use crate::dsse::{Envelope, EnvelopeError};
use crate::statement::subjects_in;
use marf_cache::Sha256;
use marf_keys::PublicKey;
use serde::Serialize;

/// State of the signature.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Signature {
    /// There is none.
    None,
    /// There is one, and no key was given to check it.
    NotChecked,
    /// It is of the given key, over this payload.
    Good,
    /// There is none, and a key was given.
    Missing,
    /// It is of another key than the given one.
    OtherKey,
    /// A fault says what is wrong with it.
    Bad,
}

/// Checks the statement next to the payload against a key, and its contents against the crate.
pub(super) fn check(opened: &OpenCrate, key: Option<&PublicKey>, faults: &mut Vec<String>) -> Signature {
    let (bytes, key) = match (opened.bag.tag(ATTESTATION), key) {
        (None, None) => return Signature::None,
        (None, Some(_)) => return Signature::Missing,
        (Some(_), None) => return Signature::NotChecked,
        (Some(bytes), Some(key)) => (bytes, key),
    };
    let envelope = Envelope::decode(&bytes);
    let is_of_other_key = envelope.as_ref().is_ok_and(|envelope| !envelope.names(key));
    let wrong = match envelope.and_then(|envelope| envelope.verify(key)) {
        Err(EnvelopeError::NotSigned) if is_of_other_key => return Signature::OtherKey,
        Err(error) => Some(format!("`{ATTESTATION}`: {error}")),
        Ok(statement) => wrong_subjects(opened, &statement),
    };
    match wrong {
        None => Signature::Good,
        Some(wrong) => {
            faults.push(wrong);
            Signature::Bad
        }
    }
}

/// Returns the fault of the subjects of a signed statement: they must be the manifest and the run root.
fn wrong_subjects(opened: &OpenCrate, statement: &[u8]) -> Option<String> {
    let Some(subjects) = subjects_in(statement) else {
        return Some(format!("`{ATTESTATION}` is signed, but holds no statement"));
    };
    let manifest = opened.bag.tag(MANIFEST).unwrap_or_default();
    let expected = [
        (MANIFEST, Sha256::from_content(&manifest)),
        (RUN_ROOT, Sha256::from_content(&opened.root)),
    ];
    let expected = expected.map(|(name, digest)| (name.to_owned(), digest));
    let missing = expected.iter().find(|subject| !subjects.contains(subject));
    missing.map(|(name, _)| format!("`{ATTESTATION}` is signed, but not about this `{name}`"))
}
