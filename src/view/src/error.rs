use std::io;

use crate::AccessError;

/// Why the page cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// An address that cannot be listened on.
    #[error("port {port} of {host} cannot be opened: {cause}")]
    Listen {
        /// The host.
        host: String,
        /// The port.
        port: u16,
        /// Why.
        cause: io::Error,
    },
    /// Options that would leave the page open to others.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// A prefix that is not a path.
    #[error(
        "the prefix `{0}` is not a path: it begins with `/` and has letters, digits, `-`, `_`, `.` and `/`"
    )]
    Prefix(String),
    /// The run cannot be read.
    #[error("{0}")]
    Content(String),
    /// The server cannot go on.
    #[error("the server stopped: {0}")]
    Server(io::Error),
    /// The threads for rendering cannot be started.
    #[error("the threads for rendering cannot be started: {0}")]
    Threads(String),
}

impl ViewError {
    /// Returns a hint for the user, if there is one.
    pub fn hint(&self) -> Option<&'static str> {
        match self {
            Self::Listen { cause, .. } if cause.kind() == io::ErrorKind::AddrInUse => {
                Some("another program has it: `--port 0` takes a free one")
            }
            Self::Listen { .. } => Some("`--host 127.0.0.1` is this machine alone"),
            Self::Access(error) => Some(error.hint()),
            Self::Prefix(_) | Self::Content(_) | Self::Server(_) | Self::Threads(_) => None,
        }
    }
}
