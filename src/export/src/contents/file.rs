//! Files of a crate: path, name, bytes and purpose.

use marf_cache::Digest;

/// Folder of the payload for objects under the names of their digests.
pub const OBJECTS: &str = "objects/";
/// The run root.
pub const RUN_ROOT: &str = "run.json";
/// Folder of the actions, one file a key.
pub const ACTIONS: &str = "actions/";

/// Photos whose bytes and verdicts are included.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Photos {
    /// The bytes of all, and no lineage photo by photo.
    All,
    /// These, by id, with their lineage photo by photo.
    Chosen(Vec<String>),
}

/// Source of the bytes of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Content {
    /// An object of the store.
    Object(Digest),
    /// These bytes.
    Bytes(Vec<u8>),
}

/// Purpose of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Purpose {
    /// It records the run and is always included.
    Record,
    /// It is input or output. A crate without data only names it.
    Data,
}

/// A file of the payload that the graph describes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct File {
    /// Its path in the payload.
    pub path: String,
    /// Title, for people.
    pub name: String,
    /// Its bytes.
    pub content: Content,
    /// Its purpose.
    pub purpose: Purpose,
}

/// Returns true if a text is a path or identifier that is the same in a file system, a manifest and a URI.
pub(crate) fn is_plain(text: &str) -> bool {
    let is_plain = |char: char| char.is_ascii_alphanumeric() || matches!(char, '.' | '_' | '-' | '/');
    crate::bag::is_safe(text) && text.chars().all(is_plain)
}
