//! Makes keys that sign.

use std::fs::OpenOptions;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use marf_keys::SigningKey;
use serde::Serialize;

use crate::error::{Diagnostic, Error};
use crate::files;
use crate::trust::{bad_key, own_key};

/// A key that was made.
#[derive(Debug, Serialize)]
pub struct NewKey {
    /// File of the private key, for its owner alone.
    pub private: PathBuf,
    /// File of the public key, for everybody.
    pub public: PathBuf,
    /// The name of the key in signatures.
    pub id: String,
}

/// Makes a key, by default that of the user, with which results are signed from then on.
///
/// # Errors
/// A key that is there already. A folder that cannot be written.
pub fn new_key(out: Option<&Path>) -> Result<NewKey, Error> {
    let private = out.map(Path::to_owned).or_else(own_key).ok_or_else(|| {
        Error::usage("the system names no folder for configuration: name a file with --out".to_owned())
    })?;
    let public = private.with_extension("pub.pem");
    let text = SigningKey::new_pem().map_err(|error| bad_key(&private, &error))?;
    let key = SigningKey::from_pem(&text).map_err(|error| bad_key(&private, &error))?;
    let folder = private.parent().map_or(Ok(()), std::fs::create_dir_all);
    folder
        .and_then(|()| write_private(&private, text.as_bytes()))
        .map_err(|error| {
            let message = format!("the key {} cannot be written: {error}", private.display());
            Error::Failed(
                Diagnostic::new(message).hint("name another file with --out. A key is never replaced"),
            )
        })?;
    files::write(&public, key.public().to_pem().as_bytes())?;
    Ok(NewKey {
        private,
        public,
        id: key.public().id().to_string(),
    })
}

/// Writes a new file that only its owner can read.
fn write_private(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut file = options.open(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}
