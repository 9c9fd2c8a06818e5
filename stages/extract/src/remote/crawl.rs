//! Folder pages of a server, cached from run to run.

use marf_pds::listing::{self, Entry};
use marf_stage::{Ctx, StageError};
use serde::{Deserialize, Serialize};

use super::cache;
use crate::net::{Answer, Client, Download, Url, Validators};

/// Largest page that is read.
const MAX_PAGE_BYTES: u64 = 16 << 20;

/// Reads the folders of a server.
pub(crate) struct Crawl<'a> {
    /// The context of the stage.
    pub ctx: &'a Ctx<'a>,
    /// The client.
    pub client: &'a Client,
    /// Addresses of the archive, in order of preference.
    pub bases: &'a [String],
}

/// A folder to be listed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Folder {
    /// Below the base, without slashes at its ends.
    pub path: String,
    /// It is too old to change: once it was listed as such, it is not asked for again.
    pub settled: bool,
}

/// A folder as it was last listed.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Page {
    url: String,
    validators: Validators,
    /// It was too old to change when it was listed.
    #[serde(default)]
    settled: bool,
    /// None: it is not there.
    entries: Option<Vec<Entry>>,
}

impl Crawl<'_> {
    /// Lists folders; `None` stands for one that is not there.
    ///
    /// # Errors
    /// A server that cannot be asked, a page that is no listing, the wish to stop.
    pub fn folders(&self, folders: &[Folder]) -> Result<Vec<Option<Vec<Entry>>>, StageError> {
        let mut pages: Vec<Option<Page>> = folders.iter().map(|folder| self.cached(&folder.path)).collect();
        let asked: Vec<usize> = (0..folders.len())
            .filter(|index| {
                !(folders[*index].settled && pages[*index].as_ref().is_some_and(|page| page.settled))
            })
            .collect();
        let want = |index: &usize| {
            Ok(Download {
                urls: urls(self.bases, &format!("{}/", folders[*index].path))?,
                cap_bytes: MAX_PAGE_BYTES,
                known: pages[*index].as_ref().map(|page| page.validators.clone()),
                part: None,
            })
        };
        let wants = asked
            .iter()
            .map(want)
            .collect::<Result<Vec<Download>, StageError>>()?;
        let total = wants.len() as u64;
        let mut done = 0;
        self.client.get_all(self.ctx, &wants, &mut |number, answer| {
            let index = asked[number];
            let answer = answer?;
            let page = read(answer, &folders[index].path)?.or_else(|| pages[index].take());
            if let Some(mut page) = page {
                page.settled = folders[index].settled;
                self.cache(&folders[index].path, &page);
                pages[index] = Some(page);
            }
            done += 1;
            self.ctx.progress.at(done, total, "folders listed");
            Ok(())
        })?;
        Ok(pages
            .into_iter()
            .map(|page| page.and_then(|page| page.entries))
            .collect())
    }

    /// Lists one folder.
    ///
    /// # Errors
    /// As [`Crawl::folders`].
    pub fn folder(&self, path: &str) -> Result<Option<Vec<Entry>>, StageError> {
        let folder = Folder {
            path: path.to_owned(),
            settled: false,
        };
        Ok(self.folders(&[folder])?.pop().flatten())
    }

    fn cached(&self, path: &str) -> Option<Page> {
        cache::read(self.ctx.scratch, &cache::key("folder", path))
    }

    fn cache(&self, path: &str, page: &Page) {
        cache::write(self.ctx.scratch, &cache::key("folder", path), page);
    }
}

/// Reads the answer to a question for a folder; `None`: nothing changed.
fn read(answer: Answer, path: &str) -> Result<Option<Page>, StageError> {
    match answer {
        Answer::Unchanged => Ok(None),
        Answer::Absent { url, .. } => Ok(Some(Page {
            url,
            ..Page::default()
        })),
        Answer::Whole {
            bytes,
            url,
            validators,
        } => {
            let entries = listing::read(&bytes).map_err(|error| {
                StageError::new(format!("`{url}` is no listing of folder `{path}`"))
                    .cause(error.to_string())
                    .hint("a firewall or another server may have answered: open the address in a browser, or set `base`")
            })?;
            Ok(Some(Page {
                url,
                validators,
                settled: false,
                entries: Some(entries),
            }))
        }
    }
}

/// Returns the addresses of a path on each mirror.
///
/// # Errors
/// A base that is no address.
pub(crate) fn urls(bases: &[String], path: &str) -> Result<Vec<Url>, StageError> {
    let address = |base: &String| {
        let text = format!("{}/{path}", base.trim_end_matches('/'));
        Url::parse(&text).map_err(|error| StageError::new(format!("`{text}` is no address: {error}")))
    };
    bases.iter().map(address).collect()
}
