//! Runs a pipeline and writes its outputs.

use std::path::{Path, PathBuf};

use marf_engine::{Options, Outcome};

use crate::batch_system;
use crate::context::Context;
use crate::error::Error;
use crate::execute::{Execution, Extras, execute_with, options};
use crate::outputs::{self, Completeness};
use crate::report;
use crate::scenes::{self, Selection};
use crate::session::Session;

/// What to run, and where to write.
#[derive(Debug, Clone)]
pub struct RunRequest {
    /// The nodes.
    pub selection: Selection,
    /// Folder of pictures, models and the report.
    pub out: PathBuf,
    /// Where to write a trace.
    pub trace: Option<PathBuf>,
    /// The site file of a batch system that computes trainings; none to compute all here.
    pub site: Option<PathBuf>,
}

/// A run of a pipeline, and the session that it was made in.
pub struct PipelineRun {
    /// The session.
    pub session: Session,
    /// The run.
    pub execution: Execution,
}

/// How often the outputs of one run may be found damaged when they are written out.
const MAX_REPAIRS: usize = 8;

/// Runs what changed, and writes pictures, models and the report. What turns out to be damaged is made again by another run.
///
/// # Errors
/// A pipeline, a selection or a site file that is wrong, a store or folder that cannot be written.
pub fn run(context: &Context, request: &RunRequest) -> Result<PipelineRun, Error> {
    let selection = &request.selection;
    let session = scenes::found(Session::open(context)?, selection)?;
    let nodes = scenes::selected(&session, selection)?;
    let mut options = Options {
        to: nodes.to,
        from: nodes.from,
        executor: batch_system::executor(context, request.site.as_deref())?,
        ..options(&session)
    };
    for _ in 0..MAX_REPAIRS {
        let execution = documented(&session, &options, request.trace.as_deref())?;
        if execution.record.outcome == Outcome::Cancelled {
            return Ok(PipelineRun { session, execution });
        }
        match outputs::write(&session, &execution.record, &request.out)? {
            Completeness::All => return Ok(PipelineRun { session, execution }),
            Completeness::Lost(lost) => {
                context.warn(format!("{}; it is made again", lost.what));
                options.lost = vec![lost.node];
            }
        }
    }
    Err(Error::failed(format!(
        "outputs were damaged {MAX_REPAIRS} times while they were written"
    )))
}

/// Runs a session's graph, and keeps the report with the run.
fn documented(session: &Session, options: &Options, trace: Option<&Path>) -> Result<Execution, Error> {
    let extras = Extras {
        trace,
        documents: &|record| report::documents(session, record),
    };
    execute_with(session, options, &extras)
}
