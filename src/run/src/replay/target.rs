//! The target of a replay.

use std::path::Path;

use marf_cache::Store;
use marf_engine::{RunRecord, run_of};

use crate::audit::identity::identify;
use crate::choice::whole_run;
use crate::context::Context;
use crate::error::{Answer, Diagnostic, Error};
use crate::files::read_named;

/// A run and one of its nodes. None for all nodes.
pub struct Target {
    pub run: RunRecord,
    pub node: Option<String>,
}

/// Returns the target that `what` names: the number of a run, a node of the last run, or a file that a run made. None names the last run.
///
/// # Errors
/// A run that cannot be read, a word that is none of these, a file that no run made.
pub fn target(context: &Context, store: &Store, what: Option<&str>) -> Result<Target, Error> {
    if let Some(number) = what.and_then(|what| what.parse().ok()) {
        let run = run_of(store, number)?;
        return Ok(Target { run, node: None });
    }
    let last = whole_run(context, store, None)?;
    let Some(what) = what else {
        return Ok(Target {
            run: last,
            node: None,
        });
    };
    if last.node(what).is_some() {
        let node = Some(what.to_owned());
        return Ok(Target { run: last, node });
    }
    let path = Path::new(what);
    if !path.is_file() {
        let known: Vec<&str> = last.nodes.iter().map(|node| node.name.as_str()).collect();
        return Err(Error::usage(format!(
            "`{what}` is not a run, a file, or a node of run {}. Its nodes are {}",
            last.number,
            known.join(", ")
        )));
    }
    let bytes = read_named(path, &context.cancel, |error| {
        Error::failed(format!("cannot read {what}: {error}"))
    })?;
    let runs = marf_engine::runs(store, context.warnings())?;
    let identity = identify(store, &runs, &bytes)?;
    let Some(maker) = identity.makers().first() else {
        let diagnostic = Diagnostic::new(format!("{what} was not made by a run of this store"));
        return Err(Error::Answered(Answer::NotOurs, diagnostic));
    };
    let number = maker.made_in.or(maker.runs.first().copied());
    let run = runs.iter().find(|run| Some(run.number) == number).cloned();
    Ok(Target {
        run: run.unwrap_or(last),
        node: maker.place.node().map(str::to_owned),
    })
}
