//! The report with a 3-D view, in one file.

use std::path::Path;

use marf_view::{Source as _, embedded_view};

use crate::context::Context;
use crate::error::{Diagnostic, Error};
use crate::status::newest_run;
use crate::view::StoreSource;
use crate::{files, report};

/// Writes the report of a run with a 3-D view of its field: of the given number, or else of the newest run. Splats of the field are made
/// unless the store has them.
///
/// # Errors
/// No such run, a run without a field, a field without a surface, a place that cannot be written.
pub fn with_view(context: &Context, out: &Path, number: Option<u64>) -> Result<(), Error> {
    let store = context.existing_store()?;
    let record = match number {
        Some(number) => marf_engine::run_of(&store, number)?,
        None => newest_run(context, &store)?,
    };
    let source = StoreSource::open(context, Some(record.number))?;
    let fields = source.fields(record.number).map_err(Error::failed)?;
    let field = fields.first().ok_or_else(|| {
        let message = format!("run {} has no trained field for a 3-D view", record.number);
        let hint = "train one with `marf run`, or leave out `--with-3d`";
        Error::Failed(Diagnostic::new(message).hint(hint))
    })?;
    let view = embedded_view(&source, field).map_err(Error::failed)?;
    let page = report::with_view(&store, &record, &view)?;
    files::write(out, page.as_bytes())
}
