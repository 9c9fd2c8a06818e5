//! An archive on a loopback port, for tests and `marf-labs faults`: as an Apache serves it, or with chosen faults.
//!
//! ```
//! # use marf_loopback::{Reply, Server};
//! # fn main() -> std::io::Result<()> {
//! let server = Server::start()?;
//! # let bytes = [1, 2, 3];
//! server.file("/data/sol/00012/a.IMG", bytes);        // and `/data/sol/00012/` is its listing
//! server.feed("/api", |_path, query| Some(query.as_bytes().to_vec()));
//! server.script("/data/sol/00012/a.IMG", vec![Reply::status(503), Reply::Cut { after: 100 }]);
//! server.faults(7, 0.2);                              // a fifth of all other requests
//! // … ask …
//! assert!(server.most_at_once() <= 2 && server.requests().is_empty());
//! # Ok(())
//! # }
//! ```
//! Files answer `If-None-Match`, `If-Modified-Since` (equal text), `Range` and `If-Range`. A script belongs to a whole
//! target, or to a path with any query. Each request uses up one reply, then the normal answer comes. Random faults
//! depend on seed, path and how often the path was asked, never on the order of requests.

mod answer;
mod mars;
mod wire;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use parking_lot::Mutex;

/// `Last-Modified` of every file mounted without one.
pub const MODIFIED: &str = "Tue, 01 Mar 2022 10:20:00 GMT";

/// One answer out of the ordinary.
#[derive(Debug, Clone)]
pub enum Reply {
    /// The normal answer.
    Normal,
    /// A status with headers and a body.
    Status(u16, Vec<(String, String)>, Vec<u8>),
    /// The normal answer, then a reset after `after` bytes of the body.
    Reset {
        /// Bytes of the body.
        after: usize,
    },
    /// The normal head, then an orderly end after `after` bytes of the body.
    Cut {
        /// Bytes of the body.
        after: usize,
    },
    /// The normal answer with a `Content-Length` that is `more` bytes larger (or smaller).
    Announce {
        /// Bytes, negative for too short a length.
        more: i64,
    },
    /// The headers of the normal answer, status 200, and a body without length and without end.
    Endless,
    /// The normal answer, `bytes` bytes at a time with a pause between.
    Drip {
        /// Bytes of a piece.
        bytes: usize,
        /// Pause between two pieces.
        every: Duration,
    },
    /// The normal answer up to `after` bytes of the body, then silence.
    Stall {
        /// Bytes of the body.
        after: usize,
    },
    /// Silence before any byte.
    Silent,
    /// A 302 to there.
    Redirect(String),
    /// To a `Range`: a 206 of another version. Else the normal answer.
    StaleRest,
    /// To a `Range`: a 206 that begins this many bytes too late (or early). Else the normal answer.
    ShiftedRest(i64),
    /// To a `Range`: a 206 with the right head, and bytes that begin this many bytes too late. Else the normal answer.
    LyingRest(usize),
    /// To a `Range`: 416. Else the normal answer.
    NoRest,
    /// This reply, again and again.
    Always(Box<Reply>),
}

impl Reply {
    /// A status with a short page.
    pub fn status(status: u16) -> Self {
        Self::Status(status, Vec::new(), format!("<html>{status}</html>").into_bytes())
    }

    /// A status with one header.
    pub fn with(status: u16, name: &str, value: &str) -> Self {
        Self::Status(status, vec![(name.into(), value.into())], Vec::new())
    }

    /// A firewall's page that calls itself a success.
    pub fn firewall() -> Self {
        let page = b"<html><title>Request Rejected</title>Your support ID is 1</html>";
        let header = ("Content-Type".into(), "text/html".into());
        Self::Status(200, vec![header], page.to_vec())
    }

    /// This reply from now on.
    pub fn always(self) -> Self {
        Self::Always(Box::new(self))
    }
}

/// One request as it came.
#[derive(Debug, Clone)]
pub struct Request {
    /// `GET`.
    pub method: String,
    /// Path and query.
    pub target: String,
    /// Names in lower case.
    pub headers: Vec<(String, String)>,
    /// When its head was complete.
    pub at: Instant,
}

impl Request {
    /// Returns the value of a header by its name in lower case.
    pub fn header(&self, name: &str) -> Option<&str> {
        let header = self.headers.iter().find(|header| header.0 == name);
        header.map(|header| header.1.as_str())
    }

    /// Returns the target without its query.
    pub fn path(&self) -> &str {
        self.target.split('?').next().unwrap_or_default()
    }

    fn query(&self) -> &str {
        self.target.split_once('?').map_or("", |parts| parts.1)
    }
}

struct Content {
    bytes: Vec<u8>,
    etag: Option<String>,
    modified: Option<String>,
}

type Feed = Arc<dyn Fn(&str, &str) -> Option<Vec<u8>> + Send + Sync>;

#[derive(Default)]
struct State {
    files: BTreeMap<String, Content>,
    folders: BTreeSet<String>,
    feeds: BTreeMap<String, Feed>,
    scripts: BTreeMap<String, VecDeque<Reply>>,
    faults: Option<(u64, f64)>,
    asked: BTreeMap<String, u64>,
    requests: Vec<Request>,
}

struct Shared {
    state: Mutex<State>,
    address: SocketAddr,
    stop: AtomicBool,
    at_once: AtomicUsize,
    most_at_once: AtomicUsize,
}

/// A running archive. Dropping it ends it.
pub struct Server(Arc<Shared>);

impl Server {
    /// Starts an empty archive on a free port.
    ///
    /// # Errors
    /// A system without a free port.
    pub fn start() -> io::Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let shared = Arc::new(Shared {
            state: Mutex::default(),
            address: listener.local_addr()?,
            stop: AtomicBool::new(false),
            at_once: AtomicUsize::new(0),
            most_at_once: AtomicUsize::new(0),
        });
        let accepting = Arc::clone(&shared);
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                if accepting.stop.load(Ordering::SeqCst) {
                    return;
                }
                let (Ok(stream), shared) = (stream, Arc::clone(&accepting)) else {
                    continue;
                };
                std::thread::spawn(move || while shared.serve(&stream).unwrap_or(false) {});
            }
        });
        Ok(Self(shared))
    }

    /// `http://127.0.0.1:PORT`.
    pub fn origin(&self) -> String {
        format!("http://{}", self.0.address)
    }

    /// Returns the address of a path.
    pub fn url(&self, path: &str) -> String {
        format!("{}{path}", self.origin())
    }

    /// Mounts a file with an `ETag` of its bytes and a fixed `Last-Modified`. Mounting again replaces it.
    pub fn file(&self, path: &str, bytes: impl Into<Vec<u8>>) {
        let bytes = bytes.into();
        let etag = format!("\"{:x}\"", hash(&[&bytes]));
        self.file_with(path, bytes, Some(&etag), Some(MODIFIED));
    }

    /// Mounts a file with these validators.
    pub fn file_with(
        &self,
        path: &str,
        bytes: impl Into<Vec<u8>>,
        etag: Option<&str>,
        modified: Option<&str>,
    ) {
        let content = Content {
            bytes: bytes.into(),
            etag: etag.map(str::to_owned),
            modified: modified.map(str::to_owned),
        };
        self.state(|state| state.files.insert(path.to_owned(), content));
    }

    /// Takes a file away.
    pub fn remove(&self, path: &str) {
        self.state(|state| state.files.remove(path));
    }

    /// Mounts a folder that may be empty. `path` ends in `/`. Folders with files need no mounting.
    pub fn folder(&self, path: &str) {
        self.state(|state| state.folders.insert(path.to_owned()));
    }

    /// Answers a path by a function of path and query. `None` is a 404.
    pub fn feed(&self, path: &str, answer: impl Fn(&str, &str) -> Option<Vec<u8>> + Send + Sync + 'static) {
        self.state(|state| state.feeds.insert(path.to_owned(), Arc::new(answer)));
    }

    /// Answers the next requests of a target (or of a path, whatever its query) by these replies.
    pub fn script(&self, target: &str, replies: Vec<Reply>) {
        self.state(|state| state.scripts.insert(target.to_owned(), replies.into()));
    }

    /// Spoils this share of all requests without a script. 0 spoils no request.
    pub fn faults(&self, seed: u64, share: f64) {
        self.state(|state| state.faults = Some((seed, share)));
    }

    /// All requests so far, in the order they came.
    pub fn requests(&self) -> Vec<Request> {
        self.state(|state| state.requests.clone())
    }

    /// Requests for a path so far.
    pub fn requests_of(&self, path: &str) -> Vec<Request> {
        let all = self.requests();
        all.into_iter().filter(|request| request.path() == path).collect()
    }

    /// Forgets the requests so far, and how many there were at once.
    pub fn clear(&self) {
        self.state(|state| state.requests.clear());
        self.0.most_at_once.store(0, Ordering::SeqCst);
    }

    /// The greatest number of requests that were being answered at one time.
    pub fn most_at_once(&self) -> usize {
        self.0.most_at_once.load(Ordering::SeqCst)
    }

    /// The smallest time between two requests.
    pub fn smallest_gap(&self) -> Option<Duration> {
        let starts: Vec<Instant> = self.requests().iter().map(|request| request.at).collect();
        starts.windows(2).map(|pair| pair[1] - pair[0]).min()
    }

    fn state<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        change(&mut self.0.state.lock())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.0.stop.store(true, Ordering::SeqCst);
        // Wakes the acceptor.
        let _ = TcpStream::connect(self.0.address);
    }
}

/// FNV-1a over the pieces and their lengths, then a finaliser of splitmix64, since FNV's high bits mix badly.
fn hash(pieces: &[&[u8]]) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for piece in pieces {
        for byte in piece.len().to_le_bytes().iter().chain(*piece) {
            hash = (hash ^ u64::from(*byte)).wrapping_mul(0x100_0000_01b3);
        }
    }
    hash = (hash ^ (hash >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    hash = (hash ^ (hash >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    hash ^ (hash >> 31)
}
