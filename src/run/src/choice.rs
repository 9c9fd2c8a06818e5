//! Which run a request takes, where the user names none.

use marf_cache::Store;
use marf_config as config;
use marf_engine::{Outcome, RunRecord, RunSource};
use marf_model::select::{self, Selected, Subject};

use crate::context::Context;
use crate::error::{Diagnostic, Error};
use crate::session::unnamed;

/// Returns the subject of requests without a run number: the pipeline of the context, or the verbs on folders if there is no such file.
///
/// # Errors
/// A store that cannot be read.
pub fn subject(context: &Context, store: &Store) -> Result<Subject, Error> {
    if !context.file.is_file() {
        return Ok(Subject::without_file(store, context.warnings())?);
    }
    // A file that cannot be parsed now may have been run before.
    let loaded = config::load(&context.file, &[], &context.config).ok();
    let name = loaded.map(|loaded| loaded.pipeline.name.unwrap_or_else(|| unnamed(&context.file)));
    let source = RunSource::from_file(store, &context.file);
    Ok(Subject::Pipeline { source, name })
}

/// Returns the run of a number, or else the newest whole run of the subject. A newer run that is skipped is reported.
///
/// # Errors
/// A run that cannot be read, or no run with a result.
pub fn whole_run(context: &Context, store: &Store, number: Option<u64>) -> Result<RunRecord, Error> {
    if let Some(number) = number {
        return Ok(marf_engine::run_of(store, number)?);
    }
    let subject = subject(context, store)?;
    let selected = select::newest_whole(store, &subject, context.warnings())?;
    let Some(Selected { run, newer }) = selected else {
        return Err(match select::newest(store, &subject, context.warnings())? {
            None => no_run(),
            Some(run) => Error::Failed(
                Diagnostic::new(format!("run {} and those before it have no result", run.number))
                    .hint("`marf status` shows why"),
            ),
        });
    };
    if let Some(newer) = newer {
        let state = match newer.outcome {
            Outcome::Done => "is of a part",
            Outcome::Failed => "failed",
            Outcome::Cancelled => "was stopped",
        };
        context.feedback.note(&format!(
            "using run {}. Run {} is newer and {state}: name it to use it",
            run.number, newer.number
        ));
    }
    Ok(run)
}

/// Returns the error of a store or pipeline without a run.
pub fn no_run() -> Error {
    Error::Failed(Diagnostic::new("there is no run yet").hint("`marf run` makes one. `marf log` lists all"))
}

/// The runs of a store that a request may take.
pub struct RunChoice<'a> {
    context: &'a Context,
    store: &'a Store,
    /// The pipeline, or the verbs on folders, whose runs are chosen from.
    pub subject: Subject,
    /// The number that the user named.
    pub number: Option<u64>,
}

impl<'a> RunChoice<'a> {
    /// Returns the runs of the pipeline of a context, or the one of a number.
    ///
    /// # Errors
    /// A store that cannot be read.
    pub fn new(context: &'a Context, store: &'a Store, number: Option<u64>) -> Result<Self, Error> {
        let subject = subject(context, store)?;
        Ok(Self {
            context,
            store,
            subject,
            number,
        })
    }

    /// Returns the newest run for which `has` is true, or the run of the number. `without` is the error of a run for which it is false.
    /// Derived runs are only chosen by their number.
    ///
    /// # Errors
    /// No such run.
    pub fn newest_with(
        &self,
        has: impl Fn(&RunRecord) -> bool,
        without: impl Fn(&RunRecord) -> Error,
    ) -> Result<RunRecord, Error> {
        if let Some(number) = self.number {
            let run = marf_engine::run_of(self.store, number)?;
            return if has(&run) { Ok(run) } else { Err(without(&run)) };
        }
        let warnings = || self.context.warnings();
        if let Some(run) = select::newest_with(self.store, &self.subject, warnings(), has)? {
            return Ok(run);
        }
        let newest = select::newest(self.store, &self.subject, warnings())?;
        Err(newest.map_or_else(no_run, |run| without(&run)))
    }

    /// Returns the newest run, or the run of the number, in which a node has a result.
    ///
    /// # Errors
    /// No such run. The error names the nodes of the last one.
    pub fn with_result(&self, node: &str) -> Result<RunRecord, Error> {
        self.newest_with(|run| has_result(run, node), |run| without(run, node))
    }
}

/// Returns whether a node of a run ended well.
pub fn has_result(run: &RunRecord, node: &str) -> bool {
    run.node(node).is_some_and(|node| node.state.is_good())
}

/// Returns the error of a run in which a node did not end well, with the names of those that did.
pub fn without(run: &RunRecord, node: &str) -> Error {
    let good = run
        .nodes
        .iter()
        .filter(|node| node.parent.is_none() && node.state.is_good());
    let known: Vec<&str> = good.map(|node| node.name.as_str()).collect();
    Error::Usage(
        Diagnostic::new(format!("run {} has no result of a node `{node}`", run.number)).hint(format!(
            "its nodes are {}. Name one of these, or another run with --run",
            known.join(", ")
        )),
    )
}
