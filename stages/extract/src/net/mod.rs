//! A polite, bounded HTTP client for archives. The only module that opens a socket.
//!
//! ```text
//! client.rs    the blocking interface: many downloads, few connections, one caller
//! transfer.rs  one download: mirrors, tries, redirects, the body
//! limiter.rs   one host: requests at once, time between them, when to stop
//! part.rs      an unfinished body, kept on disk and continued
//! status.rs backoff.rs origin.rs range.rs rate.rs meter.rs   decisions without a socket
//! ```
//!
//! Invariants:
//! - No request goes to an origin that the configuration does not name, redirects included.
//! - Nothing is read beyond its cap.
//! - Every wait has an end.
//! - Requests, their number and their duration do not enter any result.
//!
//! - HTTP/1.1 only, no cookies, no decompression (`Accept-Encoding: identity`), redirects followed by hand.
//! - TLS is rustls on ring. Certificates are checked against the system's trust store.
//! - `HTTPS_PROXY`, `ALL_PROXY` and `NO_PROXY` of the environment apply to https. The proxy settings of macOS and
//!   Windows are not read. A loopback origin is always reached directly.

mod backoff;
mod client;
mod error;
mod limiter;
mod meter;
mod origin;
mod part;
mod range;
mod rate;
mod status;
#[cfg(test)]
mod tests;
mod transfer;

use std::path::PathBuf;
use std::time::Duration;

use serde::{Deserialize, Serialize};

pub(crate) use client::Client;
pub(crate) use error::{NetError, NetErrorKind};
pub(crate) use meter::Meter;
pub(crate) use origin::Origin;
pub(crate) use part::forget;
/// An address.
pub(crate) use reqwest::Url;

/// How a [`Client`] treats hosts.
#[derive(Debug, Clone)]
pub(crate) struct ClientSettings {
    /// The origins that may be asked, by first request or by redirect.
    pub allowed: Vec<Origin>,
    /// Requests at once to one host.
    pub per_host: usize,
    /// Time between the starts of two requests to one host.
    pub delay: Duration,
    /// Tries an address, the first included. At least 1.
    pub tries: u32,
    /// Longest wait before the second try. It doubles with each further one.
    pub first_wait: Duration,
    /// Longest of these waits. A host's own `Retry-After` may ask for more, up to 10 minutes.
    pub longest_wait: Duration,
    /// A try ends when its head is not complete after so long, or no byte of its body came for so long.
    pub stall: Duration,
    /// Window over which the mean rate of a body is taken.
    pub slow_after: Duration,
    /// Smallest mean rate over a window, bytes a second. A slower body is given up.
    pub slowest: u64,
    /// The `User-Agent`: program, version, contact.
    pub agent: String,
}

impl ClientSettings {
    /// Two connections a host, 250 ms between starts, 5 tries with waits of 1 to 60 s, 30 s without a byte, and
    /// 1 kB/s over a minute at least.
    ///
    /// `contact` is an address for those who look after the host, plain ASCII.
    pub(crate) fn polite(allowed: Vec<Origin>, contact: Option<&str>) -> Self {
        let program = concat!("marf/", env!("CARGO_PKG_VERSION"));
        Self {
            allowed,
            per_host: 2,
            delay: Duration::from_millis(250),
            tries: 5,
            first_wait: Duration::from_secs(1),
            longest_wait: Duration::from_secs(60),
            stall: Duration::from_secs(30),
            slow_after: Duration::from_secs(60),
            slowest: 1_000,
            agent: contact.map_or(program.to_owned(), |contact| format!("{program} (+{contact})")),
        }
    }
}

/// Version of a body as the host reported it. Sent back, it asks whether the body is still the same.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Validators {
    /// `ETag`, with its quotes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub etag: Option<String>,
    /// `Last-Modified`, as sent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub modified: Option<String>,
}

/// One file to download.
#[derive(Debug, Clone)]
pub(crate) struct Download {
    /// Its address on each mirror, in order of preference. The address that an unfinished part came from goes first.
    pub urls: Vec<Url>,
    /// Largest body that is taken, bytes.
    pub cap_bytes: u64,
    /// Validators of the last answer of the first address. Only that address is asked whether the file changed since.
    pub known: Option<Validators>,
    /// Path of an unfinished body, with a sidecar `PART.json` next to it. No two downloads share one.
    pub part: Option<PathBuf>,
}

/// How a download ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Answer {
    /// The body. The caller checks its content: a firewall's page is a body too. Its part stays, complete, until
    /// [`forget`]. If the process ends before then, the next one uses the part without a request.
    Whole {
        /// The body, `cap_bytes` at most.
        bytes: Vec<u8>,
        /// The address that answered, after redirects.
        url: String,
        /// What that address said of the version.
        validators: Validators,
    },
    /// The file is still what `known` says.
    Unchanged,
    /// 404 or 410 on every mirror.
    Absent {
        /// The last status.
        status: u16,
        /// The address that gave it.
        url: String,
    },
}

/// What a [`Client`] has asked so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Traffic {
    /// Requests sent, redirects and tries included.
    pub requests: u64,
    /// Tries after a failed one.
    pub retries: u64,
    /// Bodies continued from where they broke off.
    pub resumed: u64,
    /// Bytes of bodies received, broken ones included.
    pub bytes: u64,
    /// Waits before retries, summed over downloads.
    pub waited: Duration,
}
