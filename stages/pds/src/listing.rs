//! Folder pages of an archive's web server (Apache's autoindex, as a table or as `<pre>` lines).
//!
//! The page is not trusted: only relative names of plain letters and the times next to them are used.

use std::collections::BTreeMap;

mod html;
mod time;

use html::{Tag, Token};
use serde::{Deserialize, Serialize};

/// Largest page that is read. One sol folder of an archive is one page of some megabytes.
const MAX_PAGE_BYTES: usize = 16 << 20;
/// Most names of one page.
const MAX_ENTRIES: usize = 100_000;
/// Longest name, bytes: what file systems take.
const MAX_NAME: usize = 255;

/// A file or folder that a page lists.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Entry {
    /// Name without a slash: `[A-Za-z0-9_.-]+`, neither `.` nor `..`.
    pub name: String,
    /// The page writes it with a slash at its end.
    pub folder: bool,
    /// When it was last changed, `YYYY-MM-DDTHH:MM` in the server's zone, if the page says.
    pub modified: Option<String>,
}

/// Bytes that are not a folder listing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ListingError {
    /// Larger than any listing.
    #[error("a page of {0} bytes, at most {MAX_PAGE_BYTES} are read")]
    TooLarge(usize),
    /// Another page: a firewall's, an error's, none.
    #[error("a page of {0} bytes that is not a folder listing: no `Index of`, no columns to sort by")]
    NoListing(usize),
    /// The transfer broke off.
    #[error("a folder listing of {0} bytes that is cut short: its table does not end")]
    Cut(usize),
    /// More names than any folder has.
    #[error("a folder listing of more than {MAX_ENTRIES} names")]
    TooMany,
}

/// Reads a page into its entries, sorted by name, each name once.
///
/// Hrefs other than plain relative names are left out: sort links, the parent, absolute and percent-encoded ones,
/// entities. The text of a link is ignored (servers cut it).
///
/// # Errors
/// See [`ListingError`]. A listing without entries is not an error.
pub fn read(html: &[u8]) -> Result<Vec<Entry>, ListingError> {
    if html.len() > MAX_PAGE_BYTES {
        return Err(ListingError::TooLarge(html.len()));
    }
    let mut page = Page::default();
    let mut tokens = html::tokens(html);
    for token in tokens.by_ref() {
        page.take(&token);
        if page.entries.len() > MAX_ENTRIES {
            return Err(ListingError::TooMany);
        }
    }
    if !page.says_index || !page.has_list {
        return Err(ListingError::NoListing(html.len()));
    }
    if tokens.is_cut() || page.open_lists > 0 {
        return Err(ListingError::Cut(html.len()));
    }
    Ok(page.entries.into_values().collect())
}

/// Whether a name consists of letters, digits, `_`, `.` and `-`, and is neither `.` nor `..`.
pub fn is_plain(name: &[u8]) -> bool {
    let plain = |byte: &u8| byte.is_ascii_alphanumeric() || b"_.-".contains(byte);
    (1..=MAX_NAME).contains(&name.len()) && name.iter().all(plain) && !matches!(name, b"." | b"..")
}

/// State of reading a page.
#[derive(Default)]
struct Page {
    entries: BTreeMap<String, Entry>,
    /// A heading that begins with `Index of`, or a link that sorts the columns.
    says_index: bool,
    has_list: bool,
    open_lists: usize,
    in_heading: bool,
    in_link: bool,
    /// Name of the entry whose row is being read.
    current: Option<String>,
}

impl Page {
    fn take(&mut self, token: &Token<'_>) {
        match token {
            Token::Text(text) => self.text(text),
            Token::Open(tag) => self.open(tag),
            Token::Close(name) => self.close(name),
        }
    }

    fn text(&mut self, text: &[u8]) {
        if self.in_heading {
            let start = text.trim_ascii_start();
            self.says_index |= start
                .get(..8)
                .is_some_and(|word| word.eq_ignore_ascii_case(b"Index of"));
        }
        if self.in_link {
            return;
        }
        if let Some(entry) = self
            .current
            .as_ref()
            .and_then(|name| self.entries.get_mut(name))
            .filter(|entry| entry.modified.is_none())
        {
            entry.modified = time::find(text);
        }
    }

    fn open(&mut self, tag: &Tag<'_>) {
        match tag.name.to_ascii_lowercase().as_slice() {
            b"title" | b"h1" => self.in_heading = true,
            b"table" | b"pre" | b"ul" => {
                self.has_list = true;
                self.open_lists += 1;
            }
            b"tr" | b"li" => self.current = None,
            b"a" => {
                self.in_link = true;
                self.link(tag.href.unwrap_or_default());
            }
            _ => {}
        }
    }

    fn close(&mut self, name: &[u8]) {
        match name.to_ascii_lowercase().as_slice() {
            b"title" | b"h1" => self.in_heading = false,
            b"table" | b"pre" | b"ul" => self.open_lists = self.open_lists.saturating_sub(1),
            b"a" => self.in_link = false,
            _ => {}
        }
    }

    fn link(&mut self, href: &[u8]) {
        self.current = None;
        self.says_index |= href.starts_with(b"?C=");
        let (name, folder) = match href.strip_suffix(b"/") {
            Some(name) => (name, true),
            None => (href, false),
        };
        if !is_plain(name) {
            return;
        }
        let name = String::from_utf8_lossy(name).into_owned();
        self.entries.entry(name.clone()).or_insert_with(|| Entry {
            name: name.clone(),
            folder,
            modified: None,
        });
        self.current = Some(name);
    }
}

#[cfg(test)]
mod tests;
