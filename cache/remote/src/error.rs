use marf_cache::{Digest, SetError, StoreError};

/// Why a shared store could not be used. No text of it holds a credential or an answer of a server.
#[derive(Debug, thiserror::Error)]
pub enum RemoteError {
    /// The address is invalid.
    #[error("`{url}` is not an address of a shared store: {why}")]
    BadUrl {
        /// The address, without what may be a credential.
        url: String,
        /// What is wrong.
        why: String,
    },
    /// The environment has no credentials.
    #[error("{place}: the environment has no credentials for it")]
    NoCredentials {
        /// The address.
        place: String,
    },
    /// No shared store is there.
    #[error("there is no shared store at {place}")]
    Absent {
        /// The address.
        place: String,
    },
    /// A later program wrote it.
    #[error("the shared store {place} has format {found}, but this program reads format {known}")]
    Newer {
        /// The address.
        place: String,
        /// Its form.
        found: String,
        /// The form of this program.
        known: u32,
    },
    /// The server refuses.
    #[error("{place} does not allow to {doing} `{object}`")]
    Denied {
        /// The address.
        place: String,
        /// The operation, as an infinitive.
        doing: &'static str,
        /// Name of the object.
        object: String,
    },
    /// The request failed as often as it was tried.
    #[error("{place} cannot {doing} `{object}`: {cause}")]
    Failed {
        /// The address.
        place: String,
        /// The operation, as an infinitive.
        doing: &'static str,
        /// Name of the object.
        object: String,
        /// What happened.
        cause: String,
    },
    /// An object is not what its name says.
    #[error("`{object}` of {place} is damaged: {what}")]
    Damaged {
        /// The address.
        place: String,
        /// Name of the object.
        object: String,
        /// What is wrong with it.
        what: String,
    },
    /// An object is named and not there.
    #[error("{place} lacks {what} {digest}")]
    Missing {
        /// The address.
        place: String,
        /// What it is (`blob`, `the result of key`).
        what: &'static str,
        /// Its digest.
        digest: Digest,
    },
    /// No writer that is trusted has signed it.
    #[error("{} signed by no key of `trust`, the first is {first}", in_place(*count, what, place))]
    Untrusted {
        /// The address.
        place: String,
        /// How many.
        count: usize,
        /// What they are (`result`, `run`).
        what: &'static str,
        /// The digest of the first, or its key.
        first: Digest,
    },
    /// The local store lacks a result to be pushed.
    #[error("the result of key {key} is not in the store any more")]
    NotInStore {
        /// The key.
        key: Digest,
    },
    /// Another program works on it, and the two cannot at once.
    #[error("{place} is in use by {holder}")]
    Busy {
        /// The address.
        place: String,
        /// Who uses it.
        holder: String,
    },
    /// Fetching the results takes longer than computing them.
    #[error("{place} takes longer than {waited_s} s to give results that were made in less")]
    Slow {
        /// The address.
        place: String,
        /// The time waited.
        waited_s: u64,
    },
    /// The user wants to stop.
    #[error("stopped")]
    Stopped,
    /// The local store cannot be read or written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A set of the local store cannot be read.
    #[error(transparent)]
    Set(#[from] SetError),
    /// The threads for requests cannot be started.
    #[error("threads for requests cannot be started: {0}")]
    Threads(std::io::Error),
}

impl RemoteError {
    /// Returns what the user can do about it, if anything.
    pub fn hint(&self) -> Option<String> {
        let hint = match self {
            Self::BadUrl { .. } => "write s3://BUCKET/PREFIX or file:///FOLDER",
            Self::NoCredentials { .. } => {
                "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, and AWS_ENDPOINT_URL for servers other than Amazon's"
            }
            Self::Absent { .. } => {
                "check the address and AWS_ENDPOINT_URL, or create one with `marf cache push`"
            }
            Self::Newer { .. } => "use the program that wrote it",
            Self::Denied { .. } => "check the credentials in the environment and what they permit",
            Self::Failed { .. } => {
                "nothing is lost: run the command again when it answers, and it continues where it stopped"
            }
            Self::Damaged { .. } | Self::Missing { .. } => {
                "`marf cache fsck --remote` lists damaged objects. `--repair` removes them, and a push sends them again"
            }
            Self::Untrusted { .. } => {
                "add the public key of their writer to `trust`, or have the writer push them again with a key (`marf key new`)"
            }
            Self::NotInStore { .. } | Self::Set(_) => "`marf run` makes it again",
            Self::Busy { .. } => {
                "wait until it has ended. The lease of a program that died ends after ten minutes"
            }
            Self::Store(error) => return error.hint(),
            Self::Slow { .. } | Self::Stopped | Self::Threads(_) => return None,
        };
        Some(hint.to_owned())
    }
}

/// Returns `1 result of PLACE is`, `2 results of PLACE are`.
fn in_place(count: usize, what: &str, place: &str) -> String {
    match count {
        1 => format!("1 {what} of {place} is"),
        _ => format!("{count} {what}s of {place} are"),
    }
}

/// What the text of an error has before an answer that is one though its status is not.
const ERROR_IN_ANSWER: &str = "Server returned error response";

/// Returns the innermost cause of an error in a few words. What a server wrote is left out: it may repeat a key.
pub(crate) fn cause_of(error: &object_store::Error) -> String {
    let mut cause: &dyn std::error::Error = error;
    loop {
        let text = cause.to_string();
        if let Some(status) = status_in(&text) {
            return format!("the server answers {status}");
        }
        if text.contains(ERROR_IN_ANSWER) {
            return "the server answers with an error".to_owned();
        }
        match cause.source() {
            Some(source) => cause = source,
            None => return text,
        }
    }
}

/// Returns the status of an answer in the text of an error.
fn status_in(text: &str) -> Option<u16> {
    let (_, rest) = text.split_once("status code: ")?;
    rest.get(..3)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cause_is_a_status_or_the_innermost_error_and_never_what_a_server_wrote() {
        let cause = |text: &str| {
            cause_of(&object_store::Error::Generic {
                store: "S3",
                source: Box::new(std::io::Error::other(text.to_owned())),
            })
        };
        let answered = "Server returned non-2xx status code: 400 Bad Request: <AWSAccessKeyId>secret</";
        assert_eq!(cause(answered), "the server answers 400");
        let answered = "Server returned error response: <Error>secret</";
        assert_eq!(cause(answered), "the server answers with an error");
        assert_eq!(cause("connection refused"), "connection refused");
    }
}
