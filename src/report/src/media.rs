//! Places of the pictures and films of a page: in it, or next to it under their digests.

use std::cell::RefCell;
use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use base64::{Engine, engine::general_purpose::STANDARD};
use marf_cache::Digest;
use maud::Markup;

/// Bytes with their type.
#[derive(Debug, Clone)]
pub struct File {
    /// Their type.
    pub media: &'static str,
    /// The bytes.
    pub bytes: Arc<[u8]>,
}

/// A page that is served with the files that it shows.
#[derive(Default)]
pub struct LinkedPage {
    /// The page.
    pub html: String,
    /// Files made for it, by digest: `object/DIGEST`.
    pub files: HashMap<Digest, File>,
    /// The objects of the store that it shows under the same addresses.
    pub objects: BTreeSet<Digest>,
}

/// Parts that a served page has in addition to the report.
pub struct LiveParts {
    /// From the page to the folder in which `object/` is: empty, or `../`.
    pub up: &'static str,
    /// Links of the head.
    pub head: Markup,
    /// Links at the beginning of the contents.
    pub navigation: Markup,
    /// Parts before the report.
    pub main: Markup,
}

/// A 3-D view that needs no server.
pub struct EmbeddedView {
    /// Parts after the first screen: what is shown, its data and its script.
    pub main: Markup,
    /// The `nonce` of the script. No other script of the page runs.
    pub nonce: String,
}

/// Places of the pictures and films of a page.
pub(super) enum Media<'a> {
    /// In the page, as data URIs.
    Embedded,
    /// As these, next to a 3-D view.
    WithView(&'a EmbeddedView),
    /// Next to it.
    Linked(&'a LiveParts, RefCell<LinkedPage>),
}

impl<'a> Media<'a> {
    /// Returns media that are linked.
    pub(super) fn linked(live: &'a LiveParts) -> Self {
        Self::Linked(live, RefCell::default())
    }

    /// Returns the parts of a page that is served.
    pub(super) fn live(&self) -> Option<&'a LiveParts> {
        match self {
            Self::Embedded | Self::WithView(_) => None,
            Self::Linked(live, _) => Some(live),
        }
    }

    /// Returns the 3-D view of a page that needs no server.
    pub(super) fn view(&self) -> Option<&'a EmbeddedView> {
        match self {
            Self::WithView(view) => Some(view),
            Self::Embedded | Self::Linked(..) => None,
        }
    }

    /// Returns the address of something made for the page.
    pub(super) fn made(&self, media: &'static str, bytes: &[u8]) -> String {
        match self {
            Self::Embedded | Self::WithView(_) => data_uri(media, bytes),
            Self::Linked(live, page) => {
                let digest = Digest::from_content(bytes);
                let bytes = bytes.into();
                page.borrow_mut().files.insert(digest, File { media, bytes });
                address(live, &digest)
            }
        }
    }

    /// Returns the address of an object of the store.
    pub(super) fn stored(&self, media: &str, digest: &Digest, bytes: &[u8]) -> String {
        match self {
            Self::Embedded | Self::WithView(_) => data_uri(media, bytes),
            Self::Linked(live, page) => {
                page.borrow_mut().objects.insert(*digest);
                address(live, digest)
            }
        }
    }

    /// Returns a page with the files that it shows.
    pub(super) fn with_files(self, html: String) -> LinkedPage {
        let page = match self {
            Self::Embedded | Self::WithView(_) => LinkedPage::default(),
            Self::Linked(_, page) => page.into_inner(),
        };
        LinkedPage { html, ..page }
    }
}

fn address(live: &LiveParts, digest: &Digest) -> String {
    format!("{}object/{digest}", live.up)
}

fn data_uri(media: &str, bytes: &[u8]) -> String {
    format!("data:{media};base64,{}", STANDARD.encode(bytes))
}
