//! Folder pages of a server, cached from run to run.

use marf_pds::listing::{self, Entry};
use marf_stage::{Ctx, StageError};

use super::pages::{PageState, Pages};
use crate::net::{Answer, Client, Download, Url, Validators};

/// Largest page that is read.
pub(crate) const MAX_PAGE_BYTES: u64 = 16 << 20;

/// Reads the folders of a server.
pub(crate) struct Crawl<'a> {
    /// The context of the stage.
    pub ctx: &'a Ctx<'a>,
    /// The client.
    pub client: &'a Client,
    /// Addresses of the archive, in order of preference.
    pub bases: &'a [String],
    /// What was listed before.
    pub pages: &'a mut Pages,
}

/// A folder to be listed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Folder {
    /// Below the base, without slashes at its ends.
    pub path: String,
    /// It is too old to change: once it was listed as such, it is not asked for again.
    pub settled: bool,
    /// Its version on another page, if that page shows every change in the folder. A folder that was listed in this
    /// version is not requested again.
    pub version: Option<String>,
}

/// What a page does that cannot be listed.
#[derive(Clone, Copy)]
enum Failing {
    /// It stops the listing.
    Stops,
    /// It is not known any more.
    Forgets,
}

impl Folder {
    /// Returns a folder that is asked for at each run.
    pub fn young(path: impl Into<String>) -> Self {
        Self {
            path: path.into(),
            settled: false,
            version: None,
        }
    }

    /// Whether the last listing still holds.
    fn holds(&self, page: &PageState) -> bool {
        (self.settled && page.settled) || (self.version.is_some() && self.version == page.version)
    }
}

impl Crawl<'_> {
    /// Lists folders whose last listing may be out of date. Afterwards [`Pages`] has all of them, also missing ones.
    ///
    /// # Errors
    /// An unreachable server, a page that is not a listing, a requested stop.
    pub fn folders(&mut self, folders: &[Folder]) -> Result<(), StageError> {
        self.ask(folders, Failing::Stops)
    }

    /// As [`Crawl::folders`], for pages that the listing can do without: one that cannot be listed is not known afterwards.
    ///
    /// # Errors
    /// The wish to stop.
    pub fn hints(&mut self, folders: &[Folder]) -> Result<(), StageError> {
        self.ask(folders, Failing::Forgets)
    }

    fn ask(&mut self, folders: &[Folder], failing: Failing) -> Result<(), StageError> {
        let asked: Vec<&Folder> = folders
            .iter()
            .filter(|folder| {
                !self
                    .pages
                    .state(&folder.path)
                    .is_some_and(|page| folder.holds(page))
            })
            .collect();
        let wants = asked
            .iter()
            .map(|folder| self.want(&format!("{}/", folder.path), &folder.path, MAX_PAGE_BYTES))
            .collect::<Result<Vec<Download>, StageError>>()?;
        let (total, mut done) = (wants.len() as u64, 0);
        let (client, ctx) = (self.client, self.ctx);
        client.get_all(ctx.cancel, &wants, &mut |index, answer| {
            let folder = asked[index];
            let outcome = answer
                .map_err(StageError::from)
                .and_then(|answer| self.take(folder, answer));
            match (outcome, failing) {
                (Ok(()), _) => {}
                (Err(error), Failing::Stops) => return Err(error),
                (Err(_), Failing::Forgets) => self.pages.forget(std::slice::from_ref(&folder.path)),
            }
            done += 1;
            ctx.progress.at(done, total, "folders listed");
            Ok(())
        })
    }

    /// Lists one folder even if it is known. `None` if it does not exist.
    ///
    /// # Errors
    /// As [`Crawl::folders`].
    pub fn folder(&mut self, path: &str) -> Result<Option<Vec<Entry>>, StageError> {
        self.folders(&[Folder::young(path)])?;
        Ok(self.entries(path))
    }

    /// Returns the entries of a folder when it was last listed. `None` if it did not exist.
    pub fn entries(&self, path: &str) -> Option<Vec<Entry>> {
        self.pages.content(path)
    }

    /// Returns the question for a file or a folder page that is kept under `path`.
    ///
    /// # Errors
    /// A base that is not an address.
    pub fn want(&self, address: &str, path: &str, cap_bytes: u64) -> Result<Download, StageError> {
        Ok(Download {
            urls: urls(self.bases, address)?,
            cap_bytes,
            known: self.pages.state(path).map(|page| page.validators.clone()),
            part: None,
        })
    }

    fn take(&mut self, folder: &Folder, answer: Answer) -> Result<(), StageError> {
        let path = &folder.path;
        let state = |validators| PageState {
            validators,
            settled: folder.settled,
            version: folder.version.clone(),
            content: None,
        };
        match answer {
            Answer::Unchanged => self.pages.change(path, |page| {
                (page.settled, page.version) = (folder.settled, folder.version.clone());
            }),
            Answer::Absent { .. } => self
                .pages
                .put::<Vec<Entry>>(path, state(Validators::default()), None),
            Answer::Whole {
                bytes,
                url,
                validators,
            } => {
                let entries = listing::read(&bytes).map_err(|error| {
                    StageError::new(format!("`{url}` is not a listing of folder `{path}`"))
                        .cause(error.to_string())
                        .hint("a firewall or another server may have answered: open the address in a browser, or set `base`")
                })?;
                self.pages.put(path, state(validators), Some(&entries));
            }
        }
        Ok(())
    }
}

/// Returns the addresses of a path on each mirror.
///
/// # Errors
/// A base that is not an address.
pub(crate) fn urls(bases: &[String], path: &str) -> Result<Vec<Url>, StageError> {
    let address = |base: &String| {
        let text = format!("{}/{path}", base.trim_end_matches('/'));
        Url::parse(&text).map_err(|error| StageError::new(format!("`{text}` is not an address: {error}")))
    };
    bases.iter().map(address).collect()
}
