//! An archive of a pipeline, to be asked whether it is still as the readers expect.

use marf_stage::{ArchiveContext, Cancel, ParamError, StageError};
use serde_json::Value;

use crate::archive::ArchiveFiles;
use crate::archive::check::Check;
use crate::params::ArchiveTable;

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
