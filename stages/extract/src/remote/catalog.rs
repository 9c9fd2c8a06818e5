//! What a server has, sol by sol, and the fingerprint of a sol.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::{ContentHash, Digest, digest_of};
use marf_stage::{Ctx, StageError};

use super::lock::{Pin, SolPins};
use crate::net::{Client, Url};
use crate::sols::Sols;

/// What a server has of one sol.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct SolFiles {
    /// Files that are wanted, by name.
    pub files: BTreeMap<String, RemoteFile>,
    /// Products that are not wanted, by name, and why.
    pub left_out: BTreeMap<String, String>,
}

/// A file that is wanted.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RemoteFile {
    /// Its address on each mirror.
    pub urls: Vec<Url>,
    /// Largest size that is taken.
    pub cap_bytes: u64,
    /// When the listing says it was last changed.
    pub listed: Option<String>,
    /// Its bytes, where the listing holds them (the record of a feed).
    pub bytes: Option<Vec<u8>>,
}

/// What a server has, by sol.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Catalog {
    /// Files of the sols asked for.
    pub sols: BTreeMap<u32, SolFiles>,
    /// All sols that are there, as far as known.
    pub present: BTreeSet<u32>,
}

/// A server that can be asked what it has.
pub(crate) trait CatalogSource: Send + Sync {
    /// Asks the server; what cannot have changed is taken from the cache in the scratch folder.
    ///
    /// # Errors
    /// A server that cannot be asked or understood, the wish to stop.
    fn catalog(&self, ctx: &Ctx<'_>, client: &Client, sols: &Sols) -> Result<Catalog, StageError>;
}

/// What of a file decides whether its sol is fetched again. The names of the struct and of its fields are content of
/// fingerprints.
#[derive(ContentHash)]
struct Seen {
    name: String,
    /// Digest of bytes that come with the listing.
    bytes: Option<Digest>,
    /// Other bytes that were given under this name.
    others: Vec<Digest>,
    /// The listing says that it changed since it was fetched.
    changed: Option<String>,
}

impl SolFiles {
    /// Tells whether neither a wanted nor an unwanted file is known.
    pub fn is_empty(&self) -> bool {
        self.files.is_empty() && self.left_out.is_empty()
    }

    /// Adds what is known from earlier: products that were fetched or left out and are listed no more.
    pub fn with_history(mut self, pins: &SolPins) -> Self {
        let listed = |name: &String| self.files.contains_key(name) || self.left_out.contains_key(name);
        let gone = |name: &String| (name.clone(), "the archive lists it no longer".to_owned());
        let labels = [".xml", ".lbl", ".json"];
        let pinned = pins
            .files
            .keys()
            .filter(|name| !labels.iter().any(|end| name.to_ascii_lowercase().ends_with(end)));
        let history: Vec<(String, String)> = pinned
            .filter(|name| !listed(name))
            .map(gone)
            .chain(
                pins.left_out
                    .iter()
                    .filter(|(name, _)| !listed(name))
                    .map(|(name, why)| (name.clone(), why.clone())),
            )
            .collect();
        self.left_out.extend(history);
        self
    }

    /// Returns what the lock file names of a sol.
    pub fn of_pins(pins: &SolPins) -> Self {
        let file = |pin: &Pin| RemoteFile {
            urls: Url::parse(&pin.url).into_iter().collect(),
            cap_bytes: pin.bytes,
            listed: pin.listed.clone(),
            bytes: None,
        };
        let files = pins.files.iter().map(|(name, pin)| (name.clone(), file(pin)));
        Self {
            files: files.collect(),
            left_out: pins.left_out.clone(),
        }
    }

    /// Returns the digest of everything that decides whether the sol is fetched again: names, never addresses.
    pub fn fingerprint(&self, pins: &SolPins) -> Digest {
        let seen = self.files.iter().map(|(name, file)| {
            let pin = pins.files.get(name);
            let record = file.bytes.as_ref().map(|bytes| Digest::of(bytes));
            let is_record = record.is_some() || name.ends_with(".json");
            Seen {
                name: name.clone(),
                bytes: record.or_else(|| pin.filter(|_| is_record).map(|pin| pin.blake3)),
                others: pin
                    .map(|pin| pin.others.iter().copied().collect())
                    .unwrap_or_default(),
                changed: pin.and_then(|pin| changed(pin.listed.as_deref(), file.listed.as_deref())),
            }
        });
        let gone = pins
            .gone
            .keys()
            .filter(|name| !self.files.contains_key(*name))
            .cloned();
        let mut names: Vec<Seen> = seen.chain(gone.map(Seen::named)).collect();
        names.sort_by(|a, b| a.name.cmp(&b.name));
        digest_of(&(names, self.left_out.clone()))
    }
}

impl Seen {
    fn named(name: String) -> Self {
        Self {
            name,
            bytes: None,
            others: Vec::new(),
            changed: None,
        }
    }
}

/// Returns the listing's date, if it is another than that of what was fetched.
pub(super) fn changed(fetched: Option<&str>, listed: Option<&str>) -> Option<String> {
    match (fetched, listed) {
        (Some(fetched), Some(listed)) if fetched != listed => Some(listed.to_owned()),
        _ => None,
    }
}
