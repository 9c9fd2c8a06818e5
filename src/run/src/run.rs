//! Runs a pipeline and writes its outputs.

use std::path::Path;

use marf_engine::{NodeState, Options, Outcome};
use marf_report::Figure;

use crate::batch_system;
use crate::context::Context;
use crate::error::Error;
use crate::execute::{Execution, Extras, execute_with, options};
use crate::live_report::LiveReport;
use crate::outputs::{self, Completeness};
use crate::report;
use crate::scenes::{self, Selection};
use crate::session::Session;
use crate::verdicts;

/// A run of a pipeline, and the session that it was made in.
pub struct PipelineRun {
    /// The session.
    pub session: Session,
    /// The run.
    pub execution: Execution,
}

impl PipelineRun {
    /// Returns the figures of the first screen of the report. None of a run in which nothing ran.
    ///
    /// # Errors
    /// A store that cannot be read.
    pub fn summary(&self) -> Result<Vec<Figure>, Error> {
        let record = &self.execution.record;
        if record.nodes.iter().all(|node| node.state != NodeState::Finished) {
            return Ok(Vec::new());
        }
        verdicts::summary(&self.session, record)
    }
}

/// How often the outputs of one run may be found damaged when they are written out.
const MAX_REPAIRS: usize = 8;

/// Runs what changed, and writes pictures, models and the report into `out`. Objects that turn out to be damaged are computed again by
/// another run. `site` is the site file of a batch system that computes trainings. Without it, everything
/// is computed here.
///
/// # Errors
/// A pipeline, a selection or a site file that is wrong, a store or folder that cannot be written.
pub fn run(
    context: &Context,
    selection: &Selection,
    out: &Path,
    site: Option<&Path>,
) -> Result<PipelineRun, Error> {
    let session = scenes::found(Session::open(context)?, selection)?;
    let nodes = scenes::selected(&session, selection)?;
    let mut options = Options {
        to: nodes.to,
        from: nodes.from,
        executor: batch_system::executor(context, site)?,
        ..options(&session)
    };
    for _ in 0..MAX_REPAIRS {
        let live = LiveReport::new(&session, out);
        let extras = Extras {
            documents: &|record| report::documents(&session, record),
            listener: &live,
        };
        let execution = execute_with(&session, &options, &extras)?;
        if execution.record.outcome == Outcome::Cancelled {
            live.write_stopped(&execution.record);
            return Ok(PipelineRun { session, execution });
        }
        match outputs::write(&session, &execution.record, out)? {
            Completeness::All => return Ok(PipelineRun { session, execution }),
            Completeness::Lost(lost) => {
                context.warn(format!("{}. It is computed again", lost.what));
                options.lost = vec![lost.node];
            }
        }
    }
    Err(Error::failed(format!(
        "outputs were damaged {MAX_REPAIRS} times while they were written"
    )))
}
