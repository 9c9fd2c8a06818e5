//! What servers listed last, kept in the scratch folder: losing it costs requests and never a result.
//!
//! A page is a folder page, or the records of a sol in a feed. An index holds the
//! digest of its content and the data for requesting it again. The content is a file of its own, read only when a sol
//! is visited.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use marf_cache::Digest;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::files::{read_checked, write_checked};
use crate::net::Validators;

/// How often the index is written while pages come.
const SAVE_EVERY: Duration = Duration::from_secs(10);
/// Raised when an index or a page has another form.
const FORM: u32 = 1;

/// State of a known page.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct PageState {
    /// What the server says of this version of it.
    #[serde(default)]
    pub validators: Validators,
    /// It was too old to change when it was asked for: it is not asked for again.
    #[serde(default)]
    pub settled: bool,
    /// What another page said of its version when it was asked for: while that says the same, it is not asked for again.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub version: Option<String>,
    /// Digest of its content. `None` if the page does not exist.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub content: Option<Digest>,
}

/// The pages of one archive.
#[derive(Debug)]
pub(crate) struct Pages {
    folder: PathBuf,
    index: BTreeMap<String, PageState>,
    changed: bool,
    saved: Instant,
}

impl Pages {
    /// Opens the pages of the archive that `name` identifies. Empty if they are lost.
    pub fn open(scratch: &Path, name: &str) -> Self {
        let key = Digest::from_content(format!("pages {FORM}\n{name}").as_bytes());
        let folder = scratch.join("listings").join(key.to_string());
        let index = read_checked(&folder.join("index")).and_then(|bytes| serde_json::from_slice(&bytes).ok());
        Self {
            folder,
            index: index.unwrap_or_default(),
            changed: false,
            saved: Instant::now(),
        }
    }

    /// Returns the state of a page. A page whose content is lost is unknown.
    pub fn state(&self, path: &str) -> Option<&PageState> {
        let state = self.index.get(path)?;
        (state.content.is_none() || self.file(path).exists()).then_some(state)
    }

    /// Returns the content of a page that is there.
    pub fn content<T: DeserializeOwned>(&self, path: &str) -> Option<T> {
        let digest = self.index.get(path)?.content?;
        let bytes = read_checked(&self.file(path))?;
        (Digest::from_content(&bytes) == digest).then(|| serde_json::from_slice(&bytes).ok())?
    }

    /// Keeps a page with its content. `None` if it does not exist.
    pub fn put<T: Serialize>(&mut self, path: &str, mut state: PageState, content: Option<&T>) {
        let bytes = content.and_then(|content| serde_json::to_vec(content).ok());
        state.content = bytes.as_ref().map(|bytes| Digest::from_content(bytes));
        let old = self.index.get(path);
        if let Some(bytes) = bytes
            && !(old.is_some_and(|old| old.content == state.content) && self.file(path).exists())
        {
            write_checked(&self.file(path), bytes);
        }
        if old != Some(&state) {
            self.index.insert(path.to_owned(), state);
            self.changed = true;
        }
        if self.saved.elapsed() >= SAVE_EVERY {
            self.save();
        }
    }

    /// Changes the state of a page.
    pub fn change(&mut self, path: &str, change: impl FnOnce(&mut PageState)) {
        if let Some(state) = self.index.get_mut(path) {
            let before = state.clone();
            change(state);
            self.changed |= *state != before;
        }
    }

    /// Forgets pages: they are asked for again.
    pub fn forget(&mut self, paths: &[String]) {
        for path in paths {
            self.changed |= self.index.remove(path).is_some();
        }
    }

    /// Writes the index, if it changed.
    pub fn save(&mut self) {
        if self.changed
            && let Ok(bytes) = serde_json::to_vec(&self.index)
        {
            write_checked(&self.folder.join("index"), bytes);
        }
        (self.changed, self.saved) = (false, Instant::now());
    }

    fn file(&self, path: &str) -> PathBuf {
        self.folder
            .join(format!("{}.json", Digest::from_content(path.as_bytes())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(version: &str) -> PageState {
        PageState {
            version: Some(version.to_owned()),
            ..PageState::default()
        }
    }

    #[test]
    fn pages_are_known_again_and_a_lost_one_is_not() {
        let dir = tempfile::tempdir().unwrap();
        let mut pages = Pages::open(dir.path(), "a");
        pages.put("sol/1", state("x"), Some(&vec![1, 2]));
        pages.put("sol/2", state("x"), Some(&vec![3]));
        pages.put::<Vec<u32>>("sol/3", state("x"), None);
        pages.save();
        let mut pages = Pages::open(dir.path(), "a");
        assert_eq!(pages.index.len(), 3);
        assert_eq!(pages.content::<Vec<u32>>("sol/1"), Some(vec![1, 2]));
        assert_eq!(pages.state("sol/3").unwrap().content, None);
        std::fs::remove_file(pages.file("sol/1")).unwrap();
        std::fs::write(pages.file("sol/2"), "[9]").unwrap();
        assert_eq!(pages.state("sol/1"), None);
        assert_eq!(
            pages.content::<Vec<u32>>("sol/2"),
            None,
            "other bytes than those of the index"
        );
        pages.forget(&["sol/2".to_owned()]);
        assert_eq!(pages.state("sol/2"), None);
        assert!(Pages::open(dir.path(), "b").index.is_empty());
    }
}
