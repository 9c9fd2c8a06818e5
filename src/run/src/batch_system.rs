//! `marf run --on slurm`: nodes as jobs of a batch system.

use std::path::Path;
use std::sync::Arc;

use marf_cluster::{Cluster, Site, SiteError};
use marf_engine::Executor;
use marf_remote::{Patience, Remote};
use marf_stage::Progress;
use parking_lot::Mutex;

use crate::context::{Context, Feedback};
use crate::error::{Diagnostic, Error};
use crate::program::PROGRAM;
use crate::trust::trust;

/// Returns the executor that computes nodes as jobs, if there is a site file.
///
/// # Errors
/// A site file that is missing or not valid, a shared store that cannot be opened, or jobs on a GPU that do not report which GPU it is.
pub fn executor(context: &Context, site: Option<&Path>) -> Result<Option<Arc<dyn Executor>>, Error> {
    let Some(site) = site else {
        return Ok(None);
    };
    let refused = |error: SiteError| {
        let diagnostic = Diagnostic::new(error.to_string());
        match error {
            SiteError::Silent { .. } => Error::Failed(diagnostic.hint("run on a machine from which jobs can be submitted")),
            _ => Error::Usage(diagnostic.hint(
                "a site file has a table [executor] with `store` (the address of the shared store) and `folder` (a folder that \
                 all machines see). docs/cluster.md shows one",
            )),
        }
    };
    let site = Site::read(site).map_err(refused)?;
    let remote = Arc::new(Remote::open(
        &site.store,
        Patience::Patient,
        trust(&site.trust, context.signing)?,
    )?);
    let program =
        std::env::current_exe().map_err(|error| Error::failed(format!("this program's file: {error}")))?;
    let progress = QuestionProgress {
        feedback: context.feedback.as_ref(),
        last: Mutex::default(),
    };
    let unanswered = |error| {
        if context.cancel.is_set() {
            Error::Interrupted
        } else {
            refused(error)
        }
    };
    let mut cluster = Cluster::new(site, remote, program, &context.cancel).map_err(unanswered)?;
    cluster.ask_backend(PROGRAM, &progress, &context.cancel)?;
    Ok(Some(Arc::new(cluster)))
}

/// Reports the state of the job that asks for the backend of the others, each time that it changes.
struct QuestionProgress<'a> {
    feedback: &'a dyn Feedback,
    last: Mutex<String>,
}

impl Progress for QuestionProgress<'_> {
    fn at(&self, _done: u64, _total: u64, note: &str) {
        let mut last = self.last.lock();
        if *last != note {
            note.clone_into(&mut last);
            self.feedback.note(&format!("backend of jobs: {note}"));
        }
    }

    fn warn(&self, message: &str) {
        self.feedback.warn(message);
    }
}
