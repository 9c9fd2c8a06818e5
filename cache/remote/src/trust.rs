//! Signatures of records and runs, and the writers that are trusted.

use marf_cache::Digest;
use marf_keys::{PublicKey, SigningKey};

/// The signed bytes follow this line, so that a signature of a result is valid for nothing else.
const PURPOSE: &str = "marf shared store 1\n";

/// The key that signs this machine's results, and the writers whose results are trusted.
#[derive(Default)]
pub struct Trust {
    /// Key that signs what is sent. `None` sends it without a signature.
    pub key: Option<SigningKey>,
    /// Trusted writers. If empty, results of everybody are trusted.
    pub writers: Vec<PublicKey>,
}

impl Trust {
    /// Returns the signature of an object with this digest.
    pub(crate) fn sign(&self, digest: &Digest) -> Option<Vec<u8>> {
        Some(self.key.as_ref()?.sign(&message(digest)))
    }

    /// Returns whether an object with this digest and signature is trusted.
    pub(crate) fn believes(&self, digest: &Digest, signature: Option<&[u8]>) -> bool {
        let message = message(digest);
        let is_by =
            |writer: &PublicKey| signature.is_some_and(|signature| writer.verifies(&message, signature));
        self.writers.is_empty() || self.writers.iter().any(is_by)
    }
}

fn message(digest: &Digest) -> Vec<u8> {
    format!("{PURPOSE}{digest}").into_bytes()
}
