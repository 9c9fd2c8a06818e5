//! Shared store: results in a bucket or a folder that several machines use.
//!
//! ```text
//! format                              "marf shared store 1"
//! cas/xx/<62 hex>                     a blob from 64 KiB, as it is
//! packs/<digest>.pack, <digest>.idx   smaller blobs, and where each is; a pack is closed at 32 MiB
//! records/xx/<62 hex>                 the result of a key, and what belongs to it
//! runs/<pipeline>/<start>-<root>.json a run: its root, its keys, its documents
//! leases/                             who works on it at the moment
//! ```
//!
//! # What is believed
//! Nothing: a blob must have the digest that it was asked for by, an index, a record and a run carry a checksum. An
//! object that is not what its name says is an error that names it, after one more attempt. Whether a result is that of its
//! key nobody can tell from its bytes: records and runs may be signed ([`Trust`]), and a reader that names writers believes
//! theirs alone.
//!
//! # Order of writes
//! Blobs; packs, then their indexes; records, parts and children before what consists of them; the run. So an object
//! that is there names none that is missing, whenever a push ends, and a push skips what lies below a record that is
//! there. What a push leaves half done is used by the next one.
//!
//! # Why records are objects and small blobs are not
//! A record must be written once: only a conditional put of an object of its own makes two results for a key a
//! [`marf_cache::Conflict`] whoever comes second. A request costs the same for 1 KB as for 1 MB, so a million results are
//! a million requests (some 10 minutes at 64 in flight and 40 ms each), but a mission of 1,300 sols has 13,000 of them.
//! Small blobs are ten to a hundred times as many, need no condition, and travel in packs.
//!
//! # Several programs
//! Pushes need no lock between them. A collection and a repair are alone: each program that writes leaves a lease that it
//! renews. The age of a lease is told by the clock of the server, never by that of a client.

mod address;
mod bucket;
mod catalogue;
mod conflict;
mod error;
mod fetch;
mod fsck;
mod gc;
mod inventory;
mod kept_indexes;
mod lease;
mod names;
mod observer;
mod pack;
mod presence;
mod pull;
mod push;
mod reader;
mod remote;
mod results;
mod sealed;
mod sharing;
mod survey;
mod threads;
mod trust;

pub use address::{Patience, check_address};
pub use bucket::Traffic;
pub use conflict::in_words;
pub use error::RemoteError;
pub use fsck::{FsckOptions, RemoteFault, RemoteFsckReport};
pub use gc::{GcOptions, RemoteGcReport};
pub use observer::{Observer, Progress};
pub use pull::PullReport;
pub use push::PushReport;
pub use reader::Reader;
pub use remote::Remote;
pub use sealed::RemoteRun;
pub use sharing::Sharing;
pub use trust::Trust;
