//! Keys of shared stores: which one signs, and whose results are believed.

use std::path::{Path, PathBuf};

use marf_cache::file::{FileKind, Links, read_text};
use marf_keys::{KeyError, PublicKey, SigningKey};
use marf_remote::Trust;

use crate::error::{Diagnostic, Error};

/// The variable of the environment that names the file of the key with which results are signed.
const SIGNING_KEY: &str = "MARF_SIGNING_KEY";

/// Returns whom to believe by these files, and the key of the environment.
///
/// # Errors
/// A file that is not there, or has no key.
pub fn trust(writers: &[PathBuf]) -> Result<Trust, Error> {
    let key = std::env::var_os(SIGNING_KEY).filter(|path| !path.is_empty());
    let writers = writers.iter().map(|path| public_key(path));
    Ok(Trust {
        key: key.map(|path| signing_key(Path::new(&path))).transpose()?,
        writers: writers.collect::<Result<_, _>>()?,
    })
}

/// Reads a private key.
///
/// # Errors
/// A file that is missing, or has no private key.
pub fn signing_key(path: &Path) -> Result<SigningKey, Error> {
    SigningKey::from_pem(&key_text(path)?).map_err(|error| bad_key(path, &error))
}

/// Reads a public key.
///
/// # Errors
/// A file that is missing, or has no public key.
pub fn public_key(path: &Path) -> Result<PublicKey, Error> {
    PublicKey::from_pem(&key_text(path)?).map_err(|error| bad_key(path, &error))
}

fn key_text(path: &Path) -> Result<String, Error> {
    read_text(path, FileKind::Key, Links::Followed)
        .map_err(|error| Error::usage(format!("the key {} cannot be read: {error}", path.display())))
}

fn bad_key(path: &Path, error: &KeyError) -> Error {
    let diagnostic = Diagnostic::new(format!("the key {} cannot be used", path.display()));
    Error::Usage(
        Diagnostic {
            cause: Some(error.to_string()),
            ..diagnostic
        }
        .hint(error.hint()),
    )
}
