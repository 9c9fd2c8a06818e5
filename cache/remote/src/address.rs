//! Addresses of shared stores, and how what is behind them is opened.

use std::{path::PathBuf, time::Duration};

use object_store::{
    BackoffConfig, ClientConfigKey, ObjectStore, RetryConfig,
    aws::{AmazonS3Builder, AmazonS3ConfigKey, S3ConditionalPut},
    local::LocalFileSystem,
    path::Path,
};

use crate::error::{RemoteError, cause_of};

/// How long a program waits for a server that does not answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Patience {
    /// A verb that does nothing else: six attempts within a minute.
    Patient,
    /// A run, which goes on without the shared store: two attempts within 6 s.
    Impatient,
}

/// An address of a shared store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Address {
    S3 { bucket: String, prefix: String },
    Folder(PathBuf),
}

/// Environment variables that configure a source of credentials. At least one must be set.
const CREDENTIALS: [&str; 6] = [
    "AWS_ACCESS_KEY_ID",
    "AWS_WEB_IDENTITY_TOKEN_FILE",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
    "AWS_CONTAINER_CREDENTIALS_FULL_URI",
    "AWS_METADATA_ENDPOINT",
    "AWS_SKIP_SIGNATURE",
];

/// Checks that a text is an address of a shared store, `s3://BUCKET/PREFIX` or `file:///FOLDER`, without
/// opening it.
///
/// # Errors
/// [`RemoteError::BadUrl`].
pub fn check_address(url: &str) -> Result<(), RemoteError> {
    Address::parse(url).map(drop)
}

impl Address {
    /// Reads `s3://BUCKET/PREFIX` or `file:///FOLDER`.
    ///
    /// # Errors
    /// [`RemoteError::BadUrl`]. It does not repeat a part before `@` or behind `?`, which may be a
    /// credential.
    pub(crate) fn parse(url: &str) -> Result<Self, RemoteError> {
        let refuse = |why: &str| {
            let (scheme, rest) = url.split_once("://").unwrap_or(("", url));
            let shown = rest.rsplit('@').next().unwrap_or(rest).split('?').next();
            let shown = shown.unwrap_or_default();
            Err(RemoteError::BadUrl {
                url: if scheme.is_empty() {
                    shown.to_owned()
                } else {
                    format!("{scheme}://{shown}")
                },
                why: why.to_owned(),
            })
        };
        if url.contains(['@', '?', '#']) {
            return refuse("credentials and options come from the environment alone");
        }
        if let Some(folder) = url.strip_prefix("file://") {
            return if folder.starts_with('/') && folder.len() > 1 {
                Ok(Self::Folder(PathBuf::from(folder)))
            } else {
                refuse("a folder begins at the root: file:///FOLDER")
            };
        }
        let Some(rest) = url.strip_prefix("s3://") else {
            return refuse("it begins with s3:// or file:///");
        };
        let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
        if bucket.is_empty() {
            return refuse("it names no bucket");
        }
        Ok(Self::S3 {
            bucket: bucket.to_owned(),
            prefix: prefix.trim_matches('/').to_owned(),
        })
    }

    /// Opens the object store at the address without a request to it. A folder is created.
    pub(crate) fn open(
        &self,
        place: &str,
        patience: Patience,
    ) -> Result<(Box<dyn ObjectStore>, Path), RemoteError> {
        match self {
            Self::Folder(folder) => Ok((Box::new(open_folder(place, folder)?), Path::default())),
            Self::S3 { bucket, prefix } => Ok((
                Box::new(open_bucket(place, bucket, patience)?),
                Path::from(prefix.as_str()),
            )),
        }
    }
}

fn open_folder(place: &str, folder: &std::path::Path) -> Result<LocalFileSystem, RemoteError> {
    let failed = |cause: String| RemoteError::Failed {
        place: place.to_owned(),
        doing: "open",
        object: folder.display().to_string(),
        cause,
    };
    std::fs::create_dir_all(folder).map_err(|error| failed(error.to_string()))?;
    LocalFileSystem::new_with_prefix(folder)
        .map(|store| store.with_fsync(true))
        .map_err(|error| failed(error.to_string()))
}

fn open_bucket(
    place: &str,
    bucket: &str,
    patience: Patience,
) -> Result<impl ObjectStore + use<>, RemoteError> {
    if !CREDENTIALS.iter().any(|name| std::env::var_os(name).is_some()) {
        return Err(RemoteError::NoCredentials {
            place: place.to_owned(),
        });
    }
    // reqwest takes the provider that the process has. Another thread may have installed the same one.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let timeout = |key| AmazonS3ConfigKey::Client(key);
    let (connect, read) = patience.timeouts();
    AmazonS3Builder::from_env()
        .with_bucket_name(bucket)
        .with_conditional_put(S3ConditionalPut::ETagMatch)
        .with_retry(patience.retries())
        .with_config(timeout(ClientConfigKey::ConnectTimeout), connect)
        .with_config(timeout(ClientConfigKey::ReadTimeout), read)
        .with_config(timeout(ClientConfigKey::Timeout), "30 minutes")
        .build()
        .map_err(|error| RemoteError::BadUrl {
            url: place.to_owned(),
            why: cause_of(&error),
        })
}

impl Patience {
    /// Returns the longest waits for a connection and for the next bytes.
    fn timeouts(self) -> (&'static str, &'static str) {
        match self {
            Self::Patient => ("5 seconds", "30 seconds"),
            Self::Impatient => ("2 seconds", "3 seconds"),
        }
    }

    fn retries(self) -> RetryConfig {
        let (max_retries, seconds) = match self {
            Self::Patient => (5, 60),
            Self::Impatient => (1, 6),
        };
        RetryConfig {
            max_retries,
            retry_timeout: Duration::from_secs(seconds),
            backoff: BackoffConfig {
                init_backoff: Duration::from_millis(200),
                max_backoff: Duration::from_secs(10),
                base: 3.0,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_a_bucket_or_a_folder_and_nothing_else() {
        let s3 = |bucket: &str, prefix: &str| Address::S3 {
            bucket: bucket.to_owned(),
            prefix: prefix.to_owned(),
        };
        assert_eq!(Address::parse("s3://mars").unwrap(), s3("mars", ""));
        assert_eq!(Address::parse("s3://mars/a/b/").unwrap(), s3("mars", "a/b"));
        assert_eq!(
            Address::parse("file:///srv/marf").unwrap(),
            Address::Folder("/srv/marf".into())
        );
        for bad in [
            "",
            "mars",
            "http://mars/",
            "s3://",
            "s3:///a",
            "file://srv",
            "file:///",
        ] {
            let error = Address::parse(bad).unwrap_err();
            assert!(error.to_string().contains("is not an address"), "{bad}: {error}");
            assert!(error.hint().is_some(), "{bad}");
        }
    }

    /// No test can cut the power, so this asks how the folder was opened.
    #[test]
    fn files_of_a_folder_are_written_through_to_the_disk() {
        let dir = tempfile::tempdir().unwrap();
        let folder = open_folder("here", dir.path()).unwrap();
        assert!(format!("{folder:?}").contains("fsync: true"), "{folder:?}");
    }

    #[test]
    fn a_credential_in_an_address_is_refused_and_not_repeated() {
        for bad in [
            "s3://key:secret@mars/a",
            "s3://mars/a?token=secret",
            "http://secret@mars",
        ] {
            let error = Address::parse(bad).unwrap_err();
            assert!(
                !format!("{error} {error:?} {:?}", error.hint()).contains("secret"),
                "{error}"
            );
        }
    }
}
