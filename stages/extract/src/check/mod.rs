//! Asks an archive on a server for one thing of each kind that is read, and compares it with what the readers expect.
//!
//! ```text
//! questions.rs  one question at a time, and what its answer came to
//! product.rs    label and picture of one product
//! ```
//! Which pages there are is in `kinds/`, next to what lists them for a run. Nothing is stored.

mod product;
mod questions;

use marf_stage::{ArchiveContext, Cancel, ParamError, StageError};
use serde::Serialize;
use serde_json::Value;

pub(crate) use self::questions::{Absence, Checkup, Question, Reading};
use crate::archive::ArchiveFiles;
use crate::params::ArchiveTable;
use crate::remote::catalog::SolFiles;

/// One thing that an archive was asked for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Check {
    /// What was asked for, in words.
    pub what: String,
    /// The address that answered, or that was asked first. Absent if nothing was asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub url: Option<String>,
    /// How it compares with what the readers expect.
    pub state: CheckState,
    /// What was found, what differs, or why it was not checked.
    pub found: String,
}

/// How an answer compares with what the readers expect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CheckState {
    /// The readers read all that they need.
    AsExpected,
    /// It is missing, or something in it is not as the readers expect.
    Differs,
    /// The server gave no answer, or nothing named what to ask for.
    NotChecked,
}

/// The wanted files of one sol, as a page, table or feed names them.
pub(crate) struct ListedSol {
    /// The sol.
    pub sol: u32,
    /// Its files.
    pub files: SolFiles,
}

/// An archive of a pipeline that can be checked.
pub struct CheckedArchive(Box<dyn ArchiveFiles>);

impl CheckedArchive {
    /// Takes an `[archive.*]` table. No request is sent.
    ///
    /// # Errors
    /// Names the key that cannot be used.
    pub fn new(table: Value, context: ArchiveContext) -> Result<Self, ParamError> {
        let table: ArchiveTable = marf_stage::from_json(table)?;
        Ok(Self(table.open(context)?))
    }

    /// Asks the server. An archive on this machine has no checks.
    ///
    /// # Errors
    /// A client that cannot be started, a `base` that is not an address, the wish to stop. An answer that is missing or other
    /// than expected is a [`Check`].
    pub fn check(&self, cancel: &Cancel) -> Result<Vec<Check>, StageError> {
        self.0.check(cancel)
    }
}
