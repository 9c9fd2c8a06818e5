//! `marf run --on slurm`: nodes as jobs of a batch system.

use std::sync::Arc;

use marf_cluster::{Cluster, Site, SiteError};
use marf_engine::{Cancel, Executor};
use marf_remote::{Patience, Remote};
use marf_stage::{Progress, StageError};
use parking_lot::Mutex;

use super::args::RunArgs;
use super::error::{CliError, Diagnostic};
use super::program::PROGRAM;
use super::session::warn;
use super::trust::trust;
use crate::terminal::eprint_line;

/// Returns what computes nodes elsewhere, if that is asked for.
///
/// # Errors
/// A site file that is not there or is none; a shared store that cannot be opened; jobs on a GPU that do not tell which it is.
pub fn executor(args: &RunArgs, cancel: &Cancel) -> Result<Option<Arc<dyn Executor>>, CliError> {
    if args.on.is_none() {
        return Ok(None);
    }
    let refused = |error: SiteError| {
        let diagnostic = Diagnostic::new(error.to_string());
        match error {
            SiteError::Silent { .. } => CliError::Failed(diagnostic.hint("run on a machine from which jobs can be submitted")),
            _ => CliError::Usage(diagnostic.hint(
                "a site file has a table [executor] with `store` (the address of the shared store) and `folder` (a folder that \
                 all machines see); see the README",
            )),
        }
    };
    let site = Site::read(&args.site).map_err(refused)?;
    let remote = Arc::new(Remote::open(&site.store, Patience::Patient, trust(&site.trust)?)?);
    let program =
        std::env::current_exe().map_err(|error| CliError::failed(format!("this program's file: {error}")))?;
    let mut cluster = Cluster::new(site, remote, program).map_err(refused)?;
    cluster
        .ask_backend(PROGRAM, &Told::default(), cancel)
        .map_err(failed)?;
    Ok(Some(Arc::new(cluster)))
}

fn failed(error: StageError) -> CliError {
    match error {
        StageError::Cancelled => CliError::Interrupted,
        StageError::Failed { message, cause, hint } => CliError::Failed(Diagnostic { message, cause, hint }),
        StageError::Blob(error) => CliError::failed(error.message),
    }
}

/// Prints what is seen of the job that asks for the backend of the others, each time that it changes.
#[derive(Default)]
struct Told(Mutex<String>);

impl Progress for Told {
    fn at(&self, _done: u64, _total: u64, note: &str) {
        let mut last = self.0.lock();
        if *last != note {
            note.clone_into(&mut last);
            eprint_line(&format!("backend of jobs: {note}"));
        }
    }

    fn warn(&self, message: &str) {
        warn(message.to_owned());
    }
}
