//! What a remote archive offers, sol by sol.

use std::collections::{BTreeMap, BTreeSet};

use marf_stage::{Ctx, StageError};

use crate::net::{Client, Url};
use crate::sols::Sols;

/// What an archive offers of one sol.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Offer {
    /// Files that are wanted, by name.
    pub files: BTreeMap<String, Offered>,
    /// Products that are not wanted, by name, and why.
    pub left_out: BTreeMap<String, String>,
}

impl Offer {
    /// Tells whether there is nothing to say of the sol.
    pub fn is_empty(&self) -> bool {
        self.files.is_empty() && self.left_out.is_empty()
    }
}

/// A file that is wanted.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Offered {
    /// Its address on each mirror.
    pub urls: Vec<Url>,
    /// Largest size that is taken.
    pub cap_bytes: u64,
    /// When the listing says it was last changed.
    pub listed: Option<String>,
    /// Its bytes, where the listing holds them (the record of a feed).
    pub bytes: Option<Vec<u8>>,
}

/// What is there, by sol.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Survey {
    /// Offers of the sols asked for.
    pub offers: BTreeMap<u32, Offer>,
    /// All sols that are there, as far as known.
    pub present: BTreeSet<u32>,
}

/// An archive that can be asked what it has.
pub(crate) trait Offers: Send + Sync {
    /// Asks; what cannot have changed is taken from memory.
    ///
    /// # Errors
    /// A server that cannot be asked or understood, the wish to stop.
    fn survey(&self, ctx: &Ctx<'_>, client: &Client, sols: &Sols) -> Result<Survey, StageError>;
}
