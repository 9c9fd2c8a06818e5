//! Why a download failed.

use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use marf_stage::StageError;

use super::backoff::LONGEST_RETRY_AFTER;
use super::origin::{MAX_HOPS, Refused};

/// A download that failed.
#[derive(Debug, Clone, thiserror::Error)]
pub(crate) struct NetError {
    /// Scheme, host and path of the address asked last.
    pub url: String,
    /// What happened at the last try.
    pub kind: Box<NetErrorKind>,
    /// Tries at that address.
    pub tries: u32,
    /// From the first of these tries to the end of the last, waits included.
    pub took: Duration,
    /// Whether the same download may succeed at another time.
    pub retryable: bool,
    /// The errors of the mirrors before it, one line each.
    pub before: Vec<String>,
}

impl fmt::Display for NetError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.url, self.kind)?;
        if self.tries > 0 {
            let tries = if self.tries == 1 { "try" } else { "tries" };
            let seconds = self.took.as_secs_f64();
            write!(f, " ({} {tries} in {seconds:.1} s)", self.tries)?;
        }
        self.before
            .iter()
            .try_for_each(|line| write!(f, ". Before that, {line}"))
    }
}

impl From<NetError> for StageError {
    fn from(error: NetError) -> Self {
        let failed = Self::new(error.to_string());
        match &*error.kind {
            NetErrorKind::Part { .. } => failed.hint("free space or choose another folder, and run again"),
            NetErrorKind::Redirect(_) | NetErrorKind::NotAllowed => {
                failed.hint("check the archive's `base` addresses: only their hosts are contacted")
            }
            _ if error.retryable => failed.hint("run again later: partial downloads are kept"),
            _ => failed,
        }
    }
}

/// The cause of a failed try.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum NetErrorKind {
    /// A status that does not answer the request.
    #[error("answers status {0}")]
    Status(u16),
    /// A `Retry-After` beyond the longest accepted wait.
    #[error("asks to wait {} s: marf waits at most {} s", .wait.as_secs(), LONGEST_RETRY_AFTER.as_secs())]
    Later {
        /// The remaining wait.
        wait: Duration,
    },
    /// No connection, or it broke.
    #[error("the connection failed: {0}")]
    Broken(String),
    /// The host's certificate is not accepted.
    #[error("its certificate is refused: {0}")]
    Certificate(String),
    /// No byte for too long.
    #[error("no byte for {:.1} s, after {at} bytes", .after.as_secs_f64())]
    Stalled {
        /// The time without a byte.
        after: Duration,
        /// Bytes of the body that had come.
        at: u64,
    },
    /// Below the slowest rate.
    #[error("{rate} bytes a second, at least {slowest} are asked for")]
    Slow {
        /// Mean of the last window.
        rate: u64,
        /// The least.
        slowest: u64,
    },
    /// Past the cap.
    #[error("{bytes} bytes or more, at most {cap} are taken")]
    TooLarge {
        /// Announced or come.
        bytes: u64,
        /// The cap.
        cap: u64,
    },
    /// The body is not as long as announced.
    #[error("{came} bytes came of {announced} announced")]
    Length {
        /// By the head.
        announced: u64,
        /// In the body.
        came: u64,
    },
    /// A 206 that is not the rest that was asked for.
    #[error("the rest does not fit the kept part: {0}")]
    Rest(String),
    /// A body in an encoding that was not asked for.
    #[error("the body is encoded as `{0}`, which was not asked for")]
    Encoded(String),
    /// A redirect that is not followed.
    #[error(transparent)]
    Redirect(#[from] Refused),
    /// A redirect without a target.
    #[error("status {0} without a `Location`")]
    NoLocation(u16),
    /// Redirects without an end.
    #[error("more than {MAX_HOPS} redirects, the last to {0}")]
    TooManyRedirects(String),
    /// An origin that the configuration does not name.
    #[error("its origin is not among the archive's")]
    NotAllowed,
    /// A download without an address.
    #[error("no address is given")]
    NoAddress,
    /// No more requests are sent to the host.
    #[error("host {host} is asked no more: {why}")]
    HostStopped {
        /// Host and port.
        host: String,
        /// What it did.
        why: String,
    },
    /// The part cannot be read or written.
    #[error("part `{}`: {error}", .path.display())]
    Part {
        /// The part.
        path: PathBuf,
        /// What the system said.
        error: String,
    },
    /// Threads or TLS that could not be set up.
    #[error("cannot be started: {0}")]
    Unstarted(String),
    /// A bug of ours.
    #[error("the download ended without an answer: a bug of marf")]
    Lost,
}

impl NetErrorKind {
    /// Whether the next try may succeed.
    pub(super) fn worth_another_try(&self) -> bool {
        match self {
            Self::Broken(_)
            | Self::Stalled { .. }
            | Self::Slow { .. }
            | Self::Length { .. }
            | Self::Rest(_) => true,
            Self::Status(status) => matches!(status, 206 | 304 | 408 | 416 | 425 | 429 | 500..=599),
            _ => false,
        }
    }

    /// Whether another run may succeed.
    pub(super) fn worth_another_run(&self) -> bool {
        self.worth_another_try()
            || matches!(
                self,
                Self::Later { .. } | Self::HostStopped { .. } | Self::Part { .. }
            )
    }
}

/// Returns an error of the HTTP library as one line without the address.
pub(super) fn broken(error: reqwest::Error) -> NetErrorKind {
    let error = error.without_url();
    let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(&error);
    let mut words: Vec<String> = Vec::new();
    while let Some(current) = cause {
        if let Some(tls) = tls_error(current)
            && matches!(tls, rustls::Error::InvalidCertificate(_))
        {
            return NetErrorKind::Certificate(super::origin::cut(&tls.to_string()));
        }
        let text = super::origin::cut(&current.to_string());
        if words.last().is_none_or(|last| !last.contains(&text)) {
            words.push(text);
        }
        cause = current.source();
    }
    NetErrorKind::Broken(words.join(": "))
}

/// Returns an error of TLS, bare or inside errors of input and output, which do not name it as their source.
fn tls_error<'a>(error: &'a (dyn std::error::Error + 'static)) -> Option<&'a rustls::Error> {
    match error.downcast_ref::<std::io::Error>() {
        Some(outer) => tls_error(outer.get_ref()?),
        None => error.downcast_ref(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_says_where_what_how_often_and_how_long() {
        let mut error = NetError {
            url: "https://a.example/x".into(),
            kind: Box::new(NetErrorKind::Status(503)),
            tries: 5,
            took: Duration::from_millis(12_340),
            retryable: true,
            before: vec!["https://b.example/x: answers status 500".into()],
        };
        assert_eq!(
            error.to_string(),
            "https://a.example/x: answers status 503 (5 tries in 12.3 s). Before that, https://b.example/x: answers status 500"
        );
        let StageError::Failed { hint, .. } = error.clone().into() else {
            panic!("{error}")
        };
        assert!(hint.unwrap().contains("run again"));
        (error.tries, error.before) = (0, Vec::new());
        *error.kind = NetErrorKind::Later {
            wait: Duration::from_secs(3_600),
        };
        assert_eq!(
            error.to_string(),
            "https://a.example/x: asks to wait 3600 s: marf waits at most 600 s"
        );
    }

    #[test]
    fn a_refused_certificate_is_found_inside_other_errors() {
        let refused = rustls::Error::InvalidCertificate(rustls::CertificateError::Expired);
        let inner = std::io::Error::new(std::io::ErrorKind::InvalidData, refused.clone());
        let outer = std::io::Error::other(inner);
        assert_eq!(tls_error(&outer), Some(&refused));
        assert_eq!(tls_error(&refused), Some(&refused));
        assert_eq!(tls_error(&std::io::Error::other("text")), None);
        assert!(!NetErrorKind::Certificate(String::new()).worth_another_run());
    }

    #[test]
    fn what_may_pass_is_what_policy_retries() {
        use super::super::status::{Asked, StatusClass, classify};
        let asked = Asked {
            rest: false,
            condition: false,
        };
        for status in 100..=650 {
            if classify(status, asked) == StatusClass::Again {
                assert!(NetErrorKind::Status(status).worth_another_try(), "{status}");
            }
        }
        assert!(
            !NetErrorKind::Status(403).worth_another_try() && !NetErrorKind::NotAllowed.worth_another_run()
        );
    }
}
