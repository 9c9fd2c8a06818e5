//! Garbage collection and pinned runs.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use marf_cache::file::{FileKind, Links, read_text};
use marf_cache::{GcPlan, GcReport, Store};
use marf_stage::LOCK_FILE;
use marf_stages::PinnedProduct;

use crate::choice::whole_run;
use crate::context::Context;
use crate::error::{Diagnostic, Error};
use crate::files;

/// Folder of the store with a file for each pinned run: its name is that of the pin, its text the number of the run.
const PINS: &str = "pins";

/// What was removed.
#[derive(Debug)]
pub struct GcResult {
    /// Objects and records.
    pub report: GcReport,
    /// How many runs.
    pub runs: usize,
}

/// Removes everything that no kept run, pin, lock file or running program needs. `keep_last` is the number of runs kept for each pipeline.
/// The other limits are in the plan, to which the kept objects are added here.
///
/// # Errors
/// A store or a lock file that cannot be read.
pub fn gc(context: &Context, store: &Store, keep_last: usize, limits: GcPlan) -> Result<GcResult, Error> {
    let pins = pins(store)?;
    let pinned: BTreeSet<u64> = pins.values().copied().collect();
    let mut kept = marf_engine::kept_runs(store, keep_last, &pinned, context.warnings())?;
    let locked = marf_stages::pinned_products(&context.folder().join(LOCK_FILE)).map_err(|error| {
        Error::Failed(Diagnostic::new(error.to_string()).hint("repair marf.lock first: gc needs its pins"))
    })?;
    kept.always
        .blobs
        .extend(locked.iter().flat_map(PinnedProduct::digests));
    let plan = GcPlan {
        always: kept.always,
        runs: kept.runs.iter().map(|(_, roots)| roots.clone()).collect(),
        ..limits
    };
    let report = store.gc(&plan)?;
    let mut given_up = kept.given_up;
    given_up.extend(kept.runs.iter().skip(report.runs_kept).map(|(number, _)| *number));
    if !plan.dry_run {
        given_up.iter().try_for_each(|number| store.remove_run(*number))?;
    }
    let runs = given_up.len();
    Ok(GcResult { report, runs })
}

/// Pins a run, by default the newest whole one, so that no collection removes its results. Returns its number.
///
/// # Errors
/// A run that is not there, a name that is not a word, a store that cannot be written.
pub fn pin(context: &Context, store: &Store, name: &str, run: Option<u64>) -> Result<u64, Error> {
    let numbers = store.run_numbers()?;
    let number = match run {
        Some(number) if numbers.contains(&number) => number,
        Some(number) => {
            return Err(Error::Failed(
                Diagnostic::new(format!("there is no run {number}")).hint("`marf log` lists them"),
            ));
        }
        None => whole_run(context, store, None)?.number,
    };
    files::write(&pin_path(store, name)?, format!("{number}\n").as_bytes())?;
    Ok(number)
}

/// Lets a pinned run go with the others.
///
/// # Errors
/// A pin that is not there, a store that cannot be written.
pub fn unpin(store: &Store, name: &str) -> Result<(), Error> {
    let path = pin_path(store, name)?;
    if !path.exists() {
        let known: Vec<String> = pins(store)?.into_keys().collect();
        return Err(Error::failed(format!(
            "unknown pin `{name}`. The pins are {}",
            known.join(", ")
        )));
    }
    files::remove(&path)
}

/// Returns the path of a pin, whose name must be a plain word.
fn pin_path(store: &Store, name: &str) -> Result<PathBuf, Error> {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
    if name.is_empty() || name.starts_with('.') || !name.chars().all(is_plain) {
        return Err(Error::usage(format!(
            "a pin cannot be named `{name}`: use letters, digits, `-`, `_` and `.`"
        )));
    }
    Ok(store.dir().join(PINS).join(name))
}

/// Returns the numbers of the pinned runs by the names of their pins.
fn pins(store: &Store) -> Result<BTreeMap<String, u64>, Error> {
    let dir = store.dir().join(PINS);
    let mut pins = BTreeMap::new();
    let entries = match std::fs::read_dir(&dir) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(pins),
        entries => {
            entries.map_err(|error| Error::failed(format!("cannot read {}: {error}", dir.display())))?
        }
    };
    for entry in entries.filter_map(Result::ok) {
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.starts_with('.') {
            continue;
        }
        let number = read_text(&entry.path(), FileKind::Key, Links::Followed)
            .ok()
            .and_then(|text| text.trim().parse().ok());
        let number = number.ok_or_else(|| {
            let message = format!("the pin {} names no run", entry.path().display());
            Error::Failed(
                Diagnostic::new(message).hint(format!("write it again with `marf cache pin {name} RUN`")),
            )
        })?;
        pins.insert(name, number);
    }
    Ok(pins)
}
