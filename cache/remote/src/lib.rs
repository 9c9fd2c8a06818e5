//! Shared store: results in a bucket or a folder that several machines use.
//!
//! ```text
//! format                              "marf shared store 1"
//! cas/xx/<62 hex>                     a blob from 64 KiB, as it is
//! packs/<digest>.pack, <digest>.idx   smaller blobs, and their index. A pack is closed at 32 MiB
//! records/xx/<62 hex>                 the result of a key, and what belongs to it
//! runs/<pipeline>/<start>-<root>.json a run: its root, its keys, its documents
//! leases/                             programs that work on it now
//! ```
//!
//! # Trust
//! Nothing: a blob must have the digest that was requested, and an index, a record and a run carry a checksum. An object
//! that does not match its name is an error that names it, after one more attempt. The bytes of a result cannot show that
//! it belongs to its key. Records and runs may therefore be signed ([`Trust`]), and a reader that names trusted writers
//! accepts only theirs.
//!
//! # Order of writes
//! Blobs first, then packs, then their indexes, then records (parts and children before their parents), then the
//! run. So an object that exists names no missing object, whenever a push ends. A push skips everything below an
//! existing record. The next push uses the objects of an interrupted one.
//!
//! # Why records are objects and small blobs are not
//! A record must be written once: only a conditional put of an object of its own turns a second result for a key into a
//! [`marf_cache::Conflict`] for the later writer. A request costs the same for 1 KB as for 1 MB, so a million results are
//! a million requests (some 10 minutes at 64 in flight and 40 ms each), but a mission of 1,300 sols has 13,000 of them.
//! Small blobs are ten to a hundred times as many, need no condition, and travel in packs.
//!
//! # Several programs
//! Pushes need no lock between them. A collection and a repair are alone: each program that writes leaves a lease that it
//! renews. The clock of the server gives the age of a lease, never that of a client.

mod address;
mod bucket;
mod catalogue;
mod conflict;
mod error;
mod fetch;
mod fsck;
pub mod fuzzing;
mod gc;
mod inventory;
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
