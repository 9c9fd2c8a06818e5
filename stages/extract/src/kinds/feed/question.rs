//! Questions to a feed, page by page.

use marf_stage::{Ctx, StageError};
use serde_json::Value;

use crate::net::{Answer, Client, Download};
use crate::remote::crawl::urls;

const MAX_PAGE_BYTES: u64 = 32 << 20;

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
        self.client.get_all(self.ctx, &[want], &mut |_, answer| {
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
