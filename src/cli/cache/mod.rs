//! `marf cache`: what the store holds, whether it is whole, and what of it is no longer needed.

mod args;
mod remote;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use marf_cache::{FsckOptions, GcPlan, GcReport, Store, StoreError};
use marf_engine::Cancel;
use marf_stage::LOCK_FILE;
use marf_stages::PinnedProduct;
use serde::Serialize;
use serde_json::{Value, json};

use super::args::Global;
use super::error::{CliError, Diagnostic};
use super::files;
use super::output::print_json;
use super::session::{existing_store, open_store, store_dir, warn};
use marf_progress::duration;
use crate::terminal::{eprint_line, print_line};
use args::{FsckArgs, GcArgs};

pub use args::CacheVerb;
pub use remote::{remote_run, words};

/// Folder of the store with a file for each pinned run: its name is that of the pin, its text the number of the run.
const PINS: &str = "pins";

/// Runs a verb of `cache`.
///
/// # Errors
/// A store that is absent or cannot be read; of `fsck` also one that is not whole.
pub fn cache(global: &Global, verb: &CacheVerb, cancel: &Cancel) -> Result<(), CliError> {
    let store = match verb {
        CacheVerb::Migrate { dry_run } => return migrate(global, *dry_run),
        CacheVerb::Gc(args) if args.remote.is_some() => return remote::gc(global, args, cancel),
        CacheVerb::Fsck(args) if args.remote.is_some() => return remote::fsck(global, args, cancel),
        CacheVerb::Pull(_) => open_store(&store_dir(global, &global.file), cancel)?,
        _ => existing_store(global, cancel)?,
    };
    let done = match verb {
        CacheVerb::Stat => stat(global, &store),
        CacheVerb::Gc(args) => gc(global, &store, args),
        CacheVerb::Fsck(args) => fsck(global, &store, args),
        CacheVerb::Push(args) => remote::push(global, &store, args, cancel),
        CacheVerb::Pin { name, run } => pin(&store, name, *run),
        CacheVerb::Unpin { name } => unpin(&store, name),
        CacheVerb::Pull(args) => remote::pull(global, &store, args, cancel),
        CacheVerb::Migrate { .. } => Ok(()),
    };
    store.take_warnings().into_iter().for_each(warn);
    done
}

/// `marf cache stat`: objects, bytes, records, runs, and what each stage holds.
fn stat(global: &Global, store: &Store) -> Result<(), CliError> {
    let (all, stages) = (store.stat()?, store.stat_by_stage()?);
    let mut json = to_json(&all)?;
    if global.json {
        json["stages"] = to_json(&stages)?;
        return print_json(&json);
    }
    for (key, value) in json.as_object().into_iter().flatten() {
        print_line(&format!("{:<16} {value}", key.replace('_', " ")));
    }
    print_line(&format!(
        "\n{:<16} {:>10} {:>10} {:>14}",
        "stage", "results", "outputs", "bytes"
    ));
    for (stage, of) in stages {
        print_line(&format!(
            "{stage:<16} {:>10} {:>10} {:>14}",
            of.records, of.outputs, of.bytes
        ));
    }
    Ok(())
}

fn to_json(value: &impl Serialize) -> Result<Value, CliError> {
    serde_json::to_value(value).map_err(|error| CliError::failed(error.to_string()))
}

/// `marf cache gc`: removes what no kept run, no pin, no lock file and no running program needs.
fn gc(global: &Global, store: &Store, args: &GcArgs) -> Result<(), CliError> {
    let pins = pins(store)?;
    let pinned: BTreeSet<u64> = pins.values().copied().collect();
    let mut kept = marf_engine::kept_runs(store, args.keep_last, &pinned, warn)?;
    let folder = global.file.parent().unwrap_or(Path::new(""));
    let locked = marf_stages::pinned_products(&folder.join(LOCK_FILE)).map_err(|error| {
        CliError::Failed(
            Diagnostic::new(error.to_string())
                .hint("mend the lock first: a collection must know what it pins"),
        )
    })?;
    kept.always
        .blobs
        .extend(locked.iter().flat_map(PinnedProduct::digests));
    let plan = GcPlan {
        always: kept.always,
        runs: kept.runs.iter().map(|(_, roots)| roots.clone()).collect(),
        max_bytes: args.max_size.as_deref().map(bytes_of).transpose()?,
        grace: grace(&args.grace)?,
        dry_run: args.dry_run,
    };
    let report = store.gc(&plan)?;
    let mut given_up = kept.given_up;
    given_up.extend(kept.runs.iter().skip(report.runs_kept).map(|(number, _)| *number));
    if !args.dry_run {
        given_up.iter().try_for_each(|number| store.remove_run(*number))?;
    }
    print_gc(global, args, &report, given_up.len())
}

fn print_gc(global: &Global, args: &GcArgs, report: &GcReport, runs: usize) -> Result<(), CliError> {
    if global.json {
        let mut json = to_json(report)?;
        json["runs_removed"] = json!(runs);
        json["dry_run"] = json!(args.dry_run);
        return print_json(&json);
    }
    let would = if args.dry_run { "would remove" } else { "removed" };
    print_line(&format!(
        "{would} {runs} runs, {} records, {} memos, {} blobs: {}; kept {}",
        report.records,
        report.memos,
        report.loose_blobs + report.packed_blobs,
        megabytes(report.loose_bytes + report.pack_bytes),
        megabytes(report.kept_bytes),
    ));
    match report.missing.len() {
        0 => {}
        missing => warn(format!(
            "{missing} objects that kept runs need are missing; they are made again when they are read"
        )),
    }
    Ok(())
}

fn megabytes(bytes: u64) -> String {
    format!("{:.1} MB", bytes as f64 / 1e6)
}

/// Reads a size: `500MB`, `20GB`, or bytes.
fn bytes_of(text: &str) -> Result<u64, CliError> {
    let units = [("TB", 1e12), ("GB", 1e9), ("MB", 1e6), ("KB", 1e3), ("", 1.0)];
    let upper = text.trim().to_uppercase();
    let size = units.iter().find_map(|(unit, factor)| {
        let number: f64 = upper.strip_suffix(unit)?.trim().parse().ok()?;
        (number.is_finite() && number >= 0.0).then_some((number * factor) as u64)
    });
    size.ok_or_else(|| CliError::usage(format!("--max-size {text}: write a size, such as 20GB")))
}

/// Reads a time: `24h`, `30m`, `0s`.
fn grace(text: &str) -> Result<std::time::Duration, CliError> {
    humantime::parse_duration(text)
        .map_err(|error| CliError::usage(format!("--grace {text}: {error}; write a time, such as 24h")))
}

/// `marf cache fsck`: verifies everything that is stored.
fn fsck(global: &Global, store: &Store, args: &FsckArgs) -> Result<(), CliError> {
    let options = FsckOptions {
        read_data: args.read_data,
        repair: args.repair,
    };
    let report = store.fsck(options)?;
    if global.json {
        print_json(&report)?;
    } else {
        for fault in &report.faults {
            let object = fault
                .object
                .map(|object| format!(" {}", object.short()))
                .unwrap_or_default();
            print_line(&format!("{}{object}: {}", fault.file.display(), fault.what));
            for (stage, key) in &fault.breaks {
                print_line(&format!("  breaks a result of {stage} ({})", key.short()));
            }
        }
        for lost in &report.lost_documents {
            let (run, name, digest) = (lost.run, &lost.name, lost.digest.short());
            print_line(&format!(
                "run {run}: its {name} ({digest}) is not in the store any more"
            ));
        }
        print_line(&format!(
            "{} blobs, {} records, {} memos, {} runs; {} read; {} faults",
            report.blobs,
            report.records,
            report.memos,
            report.runs,
            megabytes(report.verified_bytes),
            report.faults.len()
        ));
    }
    match (report.faults.is_empty(), report.is_repaired) {
        (true, _) => Ok(()),
        (false, true) => {
            eprint_line("repaired: what was damaged is in quarantine, and is made again when it is needed");
            Ok(())
        }
        (false, false) => Err(CliError::Failed(
            Diagnostic::new(format!("the store has {} faults", report.faults.len())).hint(
                "`marf cache fsck --repair` sets the damaged files aside; a run makes their results again",
            ),
        )),
    }
}

/// `marf cache pin`: keeps the results of a run whatever is collected.
fn pin(store: &Store, name: &str, run: Option<u64>) -> Result<(), CliError> {
    let numbers = store.run_numbers()?;
    let number = match run {
        Some(number) if numbers.contains(&number) => number,
        Some(number) => {
            return Err(CliError::Failed(
                Diagnostic::new(format!("there is no run {number}")).hint("`marf log` lists them"),
            ));
        }
        None => *numbers
            .last()
            .ok_or_else(|| CliError::failed("there is no run yet".to_owned()))?,
    };
    files::write(&pin_path(store, name)?, format!("{number}\n").as_bytes())?;
    print_line(&format!("pinned run {number} as `{name}`"));
    Ok(())
}

/// `marf cache unpin`: lets a pinned run go with the others.
fn unpin(store: &Store, name: &str) -> Result<(), CliError> {
    let path = pin_path(store, name)?;
    if !path.exists() {
        let known: Vec<String> = pins(store)?.into_keys().collect();
        return Err(CliError::failed(format!(
            "there is no pin `{name}`; there are: {}",
            known.join(", ")
        )));
    }
    files::remove(&path)
}

/// Returns the path of a pin, whose name must be a plain word.
fn pin_path(store: &Store, name: &str) -> Result<PathBuf, CliError> {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
    if name.is_empty() || name.starts_with('.') || !name.chars().all(is_plain) {
        return Err(CliError::usage(format!(
            "a pin cannot be named `{name}`: use letters, digits, `-`, `_` and `.`"
        )));
    }
    Ok(store.dir().join(PINS).join(name))
}

/// Returns the numbers of the pinned runs by the names of their pins.
fn pins(store: &Store) -> Result<BTreeMap<String, u64>, CliError> {
    let dir = store.dir().join(PINS);
    let mut pins = BTreeMap::new();
    let entries = match std::fs::read_dir(&dir) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(pins),
        entries => {
            entries.map_err(|error| CliError::failed(format!("cannot read {}: {error}", dir.display())))?
        }
    };
    for entry in entries.filter_map(Result::ok) {
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.starts_with('.') {
            continue;
        }
        let number = std::fs::read_to_string(entry.path())
            .ok()
            .and_then(|text| text.trim().parse().ok());
        let number = number.ok_or_else(|| {
            let message = format!("the pin {} names no run", entry.path().display());
            CliError::Failed(
                Diagnostic::new(message).hint(format!("write it again with `marf cache pin {name} RUN`")),
            )
        })?;
        pins.insert(name, number);
    }
    Ok(pins)
}

/// `marf cache migrate`: makes a store of 0.1.0 one of this form.
fn migrate(global: &Global, dry_run: bool) -> Result<(), CliError> {
    let dir = store_dir(global, &global.file);
    let migration = match dry_run {
        true => Store::plan_migration(&dir)?,
        false => Store::migrate(&dir)?,
    };
    if migration.blobs == 0 && migration.runs == 0 {
        print_line(&format!("{} needs no migration", dir.display()));
        return Ok(());
    }
    let verb = if dry_run { "would keep" } else { "kept" };
    print_line(&format!(
        "{verb} {} blobs ({}) and {} runs; nothing is fetched again",
        migration.blobs,
        megabytes(migration.bytes),
        migration.runs
    ));
    if !migration.nodes.is_empty() {
        print_line("keys are computed in another way, so the next run makes these results again:");
        for node in &migration.nodes {
            print_line(&format!(
                "  {:<22} {:>12} last time",
                node.name,
                duration(node.seconds)
            ));
        }
    }
    Ok(())
}

/// Tells of a store that cannot be opened, and what to do about it.
pub fn open_error(error: StoreError) -> CliError {
    let hint = error.hint();
    let diagnostic = Diagnostic {
        message: error.to_string(),
        cause: None,
        hint,
    };
    match error {
        StoreError::Locked { .. } => {
            CliError::Locked(diagnostic.hint("wait for the other run, or give this one its own --store"))
        }
        _ => CliError::Failed(diagnostic),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_units_and_nonsense_is_refused() {
        for (text, bytes) in [
            ("0", 0),
            ("1500", 1500),
            ("2GB", 2_000_000_000),
            ("1.5 mb", 1_500_000),
        ] {
            assert_eq!(bytes_of(text).unwrap(), bytes, "{text}");
        }
        for bad in ["", "GB", "-1", "nan", "2XB", "inf"] {
            assert!(bytes_of(bad).is_err(), "{bad}");
        }
    }
}
