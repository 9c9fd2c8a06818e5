//! What a server has, sol by sol, and the fingerprint of a sol.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::{ContentHash, ContentHasher, Digest, digest_of};
use marf_stage::{Ctx, StageError};

use super::lock::{Pin, SolPins};
use super::pages::Pages;
use crate::check::Checkup;
use crate::net::{Client, Url};
use marf_stage::Sols;

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
    /// The sols asked for.
    pub sols: BTreeMap<u32, SolListing>,
    /// All sols that are there, as far as known.
    pub present: BTreeSet<u32>,
}

/// Source of the file list of a sol.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum SolListing {
    /// Pages that name its products.
    Pages(Vec<String>),
    /// It is too old to change, and everything it had is pinned: nobody was asked.
    Pinned,
}

/// The wanted files of one sol, as a page, table or feed names them.
pub(crate) struct ListedSol {
    /// The sol.
    pub sol: u32,
    /// Its files.
    pub files: SolFiles,
}

/// A request to a catalog.
#[derive(Clone, Copy)]
pub(crate) struct Question<'a> {
    /// The context of the stage.
    pub ctx: &'a Ctx<'a>,
    /// The client.
    pub client: &'a Client,
    /// The sols.
    pub sols: &'a Sols,
    /// Whether everything of a sol is pinned.
    pub is_pinned: &'a dyn Fn(u32) -> bool,
}

/// A server that lists its sols and files.
pub(crate) trait CatalogSource: Send + Sync {
    /// Describes the selected products of a sol. A sol that is pinned for another text is listed again.
    fn selection(&self) -> String;

    /// Returns the text that identifies the pages of this source in the scratch folder.
    fn name(&self) -> String;

    /// Requests the list of sols from the server. Unchangeable pages are taken from `pages`, and new pages are put
    /// there.
    ///
    /// # Errors
    /// A server that cannot be asked or understood, the wish to stop.
    fn catalog(&self, question: Question<'_>, pages: &mut Pages) -> Result<Catalog, StageError>;

    /// Returns the files of a sol from the pages that list it. `None` if one of them is lost.
    ///
    /// # Errors
    /// An invalid address.
    fn files(&self, pages: &Pages, sol: u32, listing: &[String]) -> Result<Option<SolFiles>, StageError>;

    /// Asks for one page of each kind. Returns the files of one sol, of those asked for if the server has any of them.
    ///
    /// # Errors
    /// An invalid address, the wish to stop.
    fn check(&self, sols: &Sols, checkup: &mut Checkup<'_>) -> Result<Option<ListedSol>, StageError>;
}

/// What of a file decides whether its sol is brought again: its bytes, as far as they are known.
struct Seen<'a> {
    name: &'a str,
    /// Digest of the bytes that are used: those that come with the listing, else those that are pinned.
    blake3: Option<Digest>,
    /// Other bytes that were given under this name.
    others: Vec<Digest>,
    /// The listing says that it changed since it was fetched.
    changed: Option<&'a str>,
    /// The server answered this status instead of the file.
    gone: Option<u64>,
}

impl ContentHash for Seen<'_> {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        let fields: [(&str, &dyn ContentHash); 5] = [
            ("name", &self.name),
            ("blake3", &self.blake3),
            ("others", &self.others),
            ("changed", &self.changed),
            ("gone", &self.gone),
        ];
        hasher.record("Seen", &fields);
    }
}

impl SolListing {
    /// Returns the digest of the listing, or a fixed digest if the sol is pinned and was not listed.
    pub fn digest(&self, pages: &Pages) -> Digest {
        let Self::Pages(paths) = self else {
            return Digest::from_content(b"pinned");
        };
        let state = |path: &String| (path.clone(), pages.state(path).and_then(|state| state.content));
        digest_of(&paths.iter().map(state).collect::<Vec<_>>())
    }
}

impl SolFiles {
    /// Whether neither a wanted nor an unwanted file is known.
    pub fn is_empty(&self) -> bool {
        self.files.is_empty() && self.left_out.is_empty()
    }

    /// Adds earlier products: those that were fetched or left out and are no longer listed.
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

    /// Returns the files that the lock names for a sol.
    pub fn from_pins(pins: &SolPins) -> Self {
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

    /// Returns the number of wanted files that are not pinned.
    pub fn unpinned(&self, pins: &SolPins) -> usize {
        self.files
            .keys()
            .filter(|name| !pins.files.contains_key(*name))
            .count()
    }

    /// Returns the digest of everything that decides whether the sol is fetched again: names and, where known, the
    /// bytes in use, but never addresses. Once everything is pinned and the listing has no news, it is the digest of
    /// the pins alone.
    pub fn fingerprint(&self, pins: &SolPins) -> Digest {
        let listed = self.files.iter().map(|(name, file)| {
            let pin = pins.files.get(name);
            Seen {
                name,
                blake3: file
                    .bytes
                    .as_ref()
                    .map(|bytes| Digest::from_content(bytes))
                    .or_else(|| pin.map(|pin| pin.blake3)),
                others: pin
                    .map(|pin| pin.others.iter().copied().collect())
                    .unwrap_or_default(),
                changed: pin.and_then(|pin| changed(pin.listed.as_deref(), file.listed.as_deref())),
                gone: pins
                    .gone
                    .get(name)
                    .filter(|_| pin.is_none())
                    .map(|status| u64::from(*status)),
            }
        });
        let gone = pins
            .gone
            .iter()
            .filter(|(name, _)| !self.files.contains_key(*name));
        let gone = gone.map(|(name, status)| Seen {
            name,
            blake3: None,
            others: Vec::new(),
            changed: None,
            gone: Some(u64::from(*status)),
        });
        let mut seen: Vec<Seen<'_>> = listed.chain(gone).collect();
        seen.sort_by_key(|seen| seen.name);
        digest_of(&(seen, &self.left_out))
    }
}

/// Returns the listing's date, if it differs from that of the fetched file.
pub(super) fn changed<'a>(fetched: Option<&str>, listed: Option<&'a str>) -> Option<&'a str> {
    match (fetched, listed) {
        (Some(fetched), Some(listed)) if fetched != listed => Some(listed),
        _ => None,
    }
}
