//! Questions to a feed, page by page.

use marf_cache::Digest;
use marf_pds::feed::text;
use marf_pds::values;
use marf_stage::{Ctx, StageError};
use serde_json::Value;

use crate::net::{Answer, Client, Download};
use crate::remote::crawl::urls;

pub(super) const MAX_PAGE_BYTES: u64 = 32 << 20;

/// Reads the pages of a feed.
pub(super) struct FeedPages<'a> {
    pub ctx: &'a Ctx<'a>,
    pub client: &'a Client,
    pub bases: &'a [String],
}

impl FeedPages<'_> {
    /// Downloads one page.
    pub fn one(&self, path: &str) -> Result<Value, StageError> {
        let want = Download {
            urls: urls(self.bases, path)?,
            cap_bytes: MAX_PAGE_BYTES,
            known: None,
            part: None,
        };
        let mut got = None;
        self.client.get_all(self.ctx.cancel, &[want], &mut |_, answer| {
            got = Some(answer?);
            Ok(())
        })?;
        match got {
            Some(Answer::Whole { bytes, url, .. }) => serde_json::from_slice(&bytes).map_err(|error| {
                StageError::new(format!("`{url}` answered no JSON"))
                    .cause(error.to_string())
                    .hint("a firewall may have answered: open the address in a browser, or set `base`")
            }),
            _ => Err(
                StageError::new(format!("the feed is not at {}", self.bases.join(", ")))
                    .hint("it may have moved: set `base` of the archive"),
            ),
        }
    }
}

/// The latest sol of a feed.
pub(super) struct Newest {
    /// The sol, which is that of any camera.
    pub sol: Option<u32>,
    /// The version of the whole feed, if it reports its number of photos. While it is unchanged, no photo was added.
    pub version: Option<String>,
}

impl Newest {
    /// Reads the answer to the first question.
    pub fn from_answer(json: &Value) -> Self {
        let sol = json.get("latest_sol").and_then(text);
        // Keys are sorted: the same answer is the same text.
        let version = || Digest::from_content(json.to_string().as_bytes()).to_string();
        Self {
            sol: sol.and_then(|sol| values::sol(&sol)),
            version: json.get("total").and_then(text).map(|_| version()),
        }
    }
}
