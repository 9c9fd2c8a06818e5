//! `marf cache`: inspects, cleans, verifies and shares the store.

mod args;
mod remote;

use marf_cache::{FsckOptions, GcPlan, Store};
use marf_progress::format::{count, size};
use marf_run::cache::{self, GcResult};
use marf_run::{Context, Diagnostic, Error};
use serde::Serialize;
use serde_json::{Value, json};

use super::options::RecordArgs;
use super::output::print_json;
use crate::terminal::{eprint_line, print_line};
use args::{FsckArgs, GcArgs, PullArgs, PushArgs};

pub use args::CacheVerb;

/// Runs a verb of `cache`.
pub fn cache(verb: CacheVerb, context: Context) -> Result<(), Error> {
    let context = match &verb {
        CacheVerb::Stat(record)
        | CacheVerb::Gc(GcArgs { record, .. })
        | CacheVerb::Fsck(FsckArgs { record, .. })
        | CacheVerb::Push(PushArgs { record, .. })
        | CacheVerb::Pull(PullArgs { record, .. }) => record.store.context(context),
        CacheVerb::Pin { store, .. } | CacheVerb::Unpin { store, .. } => store.context(context),
    };
    let context = match &verb {
        CacheVerb::Push(args) => args.sign.context(context),
        _ => context,
    };
    let store = match &verb {
        CacheVerb::Gc(args) if args.remote.is_some() => return remote::gc(args, args.grace()?, &context),
        CacheVerb::Fsck(args) if args.remote.is_some() => return remote::fsck(args, &context),
        CacheVerb::Pull(_) => context.open_store()?,
        _ => context.existing_store()?,
    };
    let done = match verb {
        CacheVerb::Stat(args) => stat(&args, &store),
        CacheVerb::Gc(args) => gc(&store, &args, &context),
        CacheVerb::Fsck(args) => fsck(&store, &args),
        CacheVerb::Push(args) => remote::push(&store, &args, &context),
        CacheVerb::Pull(args) => remote::pull(&store, &args, &context),
        CacheVerb::Pin { name, run, .. } => pin(&store, &name, run, &context),
        CacheVerb::Unpin { name, .. } => cache::unpin(&store, &name),
    };
    store.take_warnings().into_iter().for_each(context.warnings());
    done
}

fn pin(store: &Store, name: &str, run: Option<u64>, context: &Context) -> Result<(), Error> {
    let number = cache::pin(context, store, name, run)?;
    print_line(&format!("pinned run {number} as `{name}`"));
    Ok(())
}

/// `marf cache stat`: objects, bytes, records, runs, and the share of each stage.
fn stat(args: &RecordArgs, store: &Store) -> Result<(), Error> {
    let (all, stages) = (store.stat()?, store.stat_by_stage()?);
    let mut json = to_json(&all)?;
    if args.json {
        json["stages"] = to_json(&stages)?;
        return print_json(&json);
    }
    for (key, value) in json.as_object().into_iter().flatten() {
        let value = match value.as_u64().filter(|_| key.ends_with("bytes")) {
            Some(bytes) => size(bytes),
            None => value.to_string(),
        };
        print_line(&format!("{:<16} {value}", key.replace('_', " ")));
    }
    print_line("");
    print_line(&format!(
        "{:<16} {:>10} {:>10} {:>14}",
        "stage", "results", "outputs", "size"
    ));
    for (stage, of) in stages {
        print_line(&format!(
            "{stage:<16} {:>10} {:>10} {:>14}",
            of.records,
            of.outputs,
            size(of.bytes)
        ));
    }
    Ok(())
}

fn to_json(value: &impl Serialize) -> Result<Value, Error> {
    serde_json::to_value(value).map_err(|error| Error::failed(error.to_string()))
}

/// `marf cache gc`: removes what no kept run, no pin, no lock file and no running program needs.
fn gc(store: &Store, args: &GcArgs, context: &Context) -> Result<(), Error> {
    let limits = GcPlan {
        max_bytes: args.max_size.as_deref().map(bytes_of).transpose()?,
        grace: args.grace()?,
        dry_run: args.dry_run,
        ..GcPlan::default()
    };
    let GcResult { report, runs } = cache::gc(context, store, args.keep_last, limits)?;
    if args.record.json {
        let mut json = to_json(&report)?;
        json["runs_removed"] = json!(runs);
        json["dry_run"] = json!(args.dry_run);
        return print_json(&json);
    }
    let would = if args.dry_run { "would remove" } else { "removed" };
    print_line(&format!(
        "{would} {}, {} records, {} memos, {} blobs: {}, kept {}",
        count(runs, "run"),
        report.records,
        report.memos,
        report.loose_blobs + report.packed_blobs,
        size(report.loose_bytes + report.pack_bytes),
        size(report.kept_bytes),
    ));
    match report.missing.len() {
        0 => {}
        missing => context.warn(format!(
            "the store lacks {} that kept runs need. A run computes what it reads again",
            count(missing, "object")
        )),
    }
    Ok(())
}

/// Reads a size: `500MB`, `20GB`, or bytes.
fn bytes_of(text: &str) -> Result<u64, Error> {
    let units = [("TB", 1e12), ("GB", 1e9), ("MB", 1e6), ("KB", 1e3), ("", 1.0)];
    let upper = text.trim().to_uppercase();
    let size = units.iter().find_map(|(unit, factor)| {
        let number: f64 = upper.strip_suffix(unit)?.trim().parse().ok()?;
        (number.is_finite() && number >= 0.0).then_some((number * factor) as u64)
    });
    size.ok_or_else(|| Error::usage(format!("--max-size {text}: write a size, such as 20GB")))
}

/// `marf cache fsck`: verifies everything that is stored.
fn fsck(store: &Store, args: &FsckArgs) -> Result<(), Error> {
    let options = FsckOptions {
        read_data: args.read_data.unwrap_or_default(),
        repair: args.repair,
    };
    let report = store.fsck(options)?;
    if args.record.json {
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
            "{} blobs, {} records, {} memos, {}, {} read, {}",
            report.blobs,
            report.records,
            report.memos,
            count(report.runs as usize, "run"),
            size(report.verified_bytes),
            count(report.faults.len(), "fault")
        ));
    }
    if report.faults.is_empty() {
        return Ok(());
    }
    if report.is_repaired {
        eprint_line(
            "repaired: damaged files are in quarantine. A run computes their results again when it needs them",
        );
        return Ok(());
    }
    Err(Error::Failed(
        Diagnostic::new(format!("the store has {}", count(report.faults.len(), "fault")))
            .hint("`marf cache fsck --repair` quarantines the damaged files. A run then computes their results again"),
    ))
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
