//! `marf run --on slurm`: nodes as jobs of a batch system.

use std::sync::Arc;

use marf_cluster::{Cluster, Site, SiteError};
use marf_engine::Executor;
use marf_remote::{Patience, Remote};

use super::args::RunArgs;
use super::error::{CliError, Diagnostic};
use super::trust::trust;

/// Returns what computes nodes elsewhere, if that is asked for.
///
/// # Errors
/// A site file that is not there or is none; a shared store that cannot be opened.
pub fn executor(args: &RunArgs) -> Result<Option<Arc<dyn Executor>>, CliError> {
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
    Ok(Some(Arc::new(
        Cluster::new(site, remote, program).map_err(refused)?,
    )))
}
