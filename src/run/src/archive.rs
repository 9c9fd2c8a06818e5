//! Asks the archives of a pipeline whether they are still as the readers expect.

use marf_config::nearest::did_you_mean;
use marf_config::{GlobalOptions, load};
use marf_stage::{Access, ArchiveContext, LOCK_FILE};
use marf_stages::{ArchiveDef, CheckedArchive, archives};
pub use marf_stages::{Check, CheckState};
use serde::Serialize;
use serde_json::Value;

use crate::context::Context;
use crate::error::{Answer, Diagnostic, Error};

/// What the archives of a pipeline were asked, and what came of it.
#[derive(Debug, Serialize)]
pub struct ArchiveReport {
    /// The worst state of any check.
    pub answer: CheckState,
    /// The archives, by name.
    pub archives: Vec<ArchiveChecks>,
}

/// The checks of one archive.
#[derive(Debug, Serialize)]
pub struct ArchiveChecks {
    /// Name of its `[archive.*]` table.
    pub name: String,
    /// Its kind.
    pub kind: &'static str,
    /// One for each thing that it was asked for.
    pub checks: Vec<Check>,
}

/// Asks the archive of this name, or all archives of the pipeline that are on servers, for one page of each kind, one label and one
/// picture.
///
/// # Errors
/// A pipeline that cannot be used, or that has no such archive. A client that cannot be started.
pub fn check(context: &Context, name: Option<&str>) -> Result<ArchiveReport, Error> {
    let loaded = load(&context.file, &context.sets, &GlobalOptions::default())?;
    let tables = loaded.pipeline.tree["archive"]
        .as_object()
        .cloned()
        .unwrap_or_default();
    if let Some(name) = name.filter(|name| !tables.contains_key(*name)) {
        let hint = did_you_mean(name, tables.keys().map(String::as_str));
        let message = format!("{} has no archive `{name}`", context.file.display());
        return Err(Error::Usage(Diagnostic::with_hint(message, hint)));
    }
    let mut found = Vec::new();
    for (own, table) in tables {
        let is_named = name.is_none_or(|name| name == own);
        if let Some(def) = definition(&table).filter(|def| is_named && def.remote) {
            context.feedback.note(&format!("asking archive `{own}`"));
            found.push(ArchiveChecks {
                checks: checks(context, &own, table)?,
                kind: def.kind,
                name: own,
            });
        }
    }
    if found.is_empty() {
        return Err(nothing_to_ask(context, name));
    }
    let states = found
        .iter()
        .flat_map(|archive| &archive.checks)
        .map(|check| check.state);
    Ok(ArchiveReport {
        answer: worst(states),
        archives: found,
    })
}

fn definition(table: &Value) -> Option<&'static ArchiveDef> {
    archives().iter().find(|def| table["kind"] == def.kind)
}

fn checks(context: &Context, name: &str, table: Value) -> Result<Vec<Check>, Error> {
    let surroundings = ArchiveContext {
        name: name.to_owned(),
        folder: context.folder().to_owned(),
        lock: Some(context.folder().join(LOCK_FILE)),
        access: Access::Online,
        ..ArchiveContext::default()
    };
    let archive = CheckedArchive::new(table, surroundings)
        .map_err(|error| Error::usage(format!("archive.{name}.{}: {}", error.path, error.message)))?;
    Ok(archive.check(&context.cancel)?)
}

fn nothing_to_ask(context: &Context, name: Option<&str>) -> Error {
    let diagnostic = match name {
        Some(name) => Diagnostic::new(format!(
            "archive `{name}` is on this machine: there is no server to ask"
        )),
        None => Diagnostic::new(format!("no archive of {} is on a server", context.file.display()))
            .hint("write a pipeline with one by `marf init --mission perseverance --file perseverance.toml`"),
    };
    Error::Usage(diagnostic)
}

/// Returns the worst of states. What differs is worse than what was not checked.
fn worst(states: impl Iterator<Item = CheckState> + Clone) -> CheckState {
    let worst_first = [CheckState::Differs, CheckState::NotChecked];
    let found = worst_first
        .into_iter()
        .find(|state| states.clone().any(|one| one == *state));
    found.unwrap_or(CheckState::AsExpected)
}

impl ArchiveReport {
    /// Returns the number of checks with this state.
    fn count(&self, state: CheckState) -> usize {
        let checks = self.archives.iter().flat_map(|archive| &archive.checks);
        checks.filter(|check| check.state == state).count()
    }

    /// Returns an error if something differs, or was not checked.
    ///
    /// # Errors
    /// [`Answer::Changed`], or a failure if nothing differs and something was not checked.
    pub fn is_as_expected(&self) -> Result<(), Error> {
        let total: usize = self.archives.iter().map(|archive| archive.checks.len()).sum();
        let (differ, unchecked) = (
            self.count(CheckState::Differs),
            self.count(CheckState::NotChecked),
        );
        match self.answer {
            CheckState::AsExpected => Ok(()),
            CheckState::Differs => Err(Error::Answered(
                Answer::Changed,
                Diagnostic::new(format!("{differ} of {total} checks differ from what marf reads"))
                    .hint("open the addresses in a browser. If the archive moved, set `base`. If its form changed, look for a newer marf"),
            )),
            CheckState::NotChecked => Err(Error::Failed(
                Diagnostic::new(format!("{unchecked} of {total} things could not be checked"))
                    .hint("run again later, or set `base` of the archive"),
            )),
        }
    }
}
