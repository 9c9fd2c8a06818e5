//! Keys of shared stores: which one signs, and whose results are believed.

use std::path::{Path, PathBuf};

use marf_cache::file::{FileKind, Links, read_text};
use marf_keys::{KeyError, PublicKey, SigningKey};
use marf_remote::Trust;

use crate::context::Signing;
use crate::error::{Diagnostic, Error};

/// The variable of the environment that names the file of the key with which results are signed.
const SIGNING_KEY: &str = "MARF_SIGNING_KEY";

/// Returns whom to believe by these files, and the key that signs: that of the environment, or that of the user's configuration folder.
///
/// # Errors
/// A file that is not there, or has no key.
pub fn trust(writers: &[PathBuf], signing: Signing) -> Result<Trust, Error> {
    let named = || std::env::var_os(SIGNING_KEY).filter(|path| !path.is_empty());
    let key = match signing {
        Signing::Off => None,
        Signing::OwnKey => named()
            .map(PathBuf::from)
            .or_else(|| own_key().filter(|path| path.exists())),
    };
    let writers = writers.iter().map(|path| public_key(path));
    Ok(Trust {
        key: key.map(|path| signing_key(&path)).transpose()?,
        writers: writers.collect::<Result<_, _>>()?,
    })
}

/// Returns the place of the user's key: `marf/key.pem` in the configuration folder. `None` if the system has no such folder.
pub(crate) fn own_key() -> Option<PathBuf> {
    let folder = |name: &str| {
        std::env::var_os(name)
            .map(PathBuf::from)
            .filter(|path| path.is_absolute())
    };
    let configuration = if cfg!(windows) {
        folder("APPDATA")
    } else {
        folder("XDG_CONFIG_HOME").or_else(|| Some(folder("HOME")?.join(".config")))
    };
    Some(configuration?.join("marf/key.pem"))
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

pub(crate) fn bad_key(path: &Path, error: &KeyError) -> Error {
    let diagnostic = Diagnostic::new(format!("the key {} cannot be used", path.display()));
    Error::Usage(
        Diagnostic {
            cause: Some(error.to_string()),
            ..diagnostic
        }
        .hint(error.hint()),
    )
}
