//! `marf cache push` and `pull`, and `gc` and `fsck` with `--remote`.

use std::time::Duration;

use marf_cache::Store;
use marf_progress::format::{count, size};
use marf_remote::{FsckOptions, GcOptions};
use marf_run::cache::SharedStore;
use marf_run::{Context, Diagnostic, Error};
use serde_json::json;

use super::args::{FsckArgs, GcArgs, PullArgs, PushArgs};
use crate::cli::output::print_json;
use crate::cli::traffic::traffic_text;
use crate::terminal::{eprint_line, print_line};

/// `marf cache push`: sends a run.
pub fn push(store: &Store, args: &PushArgs, context: &Context) -> Result<(), Error> {
    let pushed = SharedStore::open(context, args.remote.as_deref())?.push(store, args.run)?;
    if args.record.json {
        return print_json(&json!(pushed));
    }
    print_line(&format!(
        "pushed run {} ({}): {} results ({} already there), {} blobs ({}), {} packs, {}",
        pushed.number,
        pushed.run.short(),
        pushed.results,
        pushed.known_results,
        pushed.blobs,
        size(pushed.blob_bytes),
        pushed.packs,
        traffic_text(pushed.traffic),
    ));
    Ok(())
}

/// `marf cache pull`: fetches a run.
pub fn pull(store: &Store, args: &PullArgs, context: &Context) -> Result<(), Error> {
    let shared = SharedStore::open(context, args.remote.as_deref())?;
    let pulled = shared.pull(store, args.run.as_deref())?;
    if args.record.json {
        return print_json(&json!(pulled));
    }
    print_line(&format!(
        "pulled run {} of `{}` as run {}: {} results ({} already here), {} blobs ({}), {}",
        pulled.run.short(),
        pulled.pipeline,
        pulled.number,
        pulled.results,
        pulled.known_results,
        pulled.blobs,
        size(pulled.blob_bytes),
        traffic_text(pulled.traffic),
    ));
    Ok(())
}

/// `marf cache gc --remote`: removes what no kept run of the shared store needs.
pub fn gc(args: &GcArgs, grace: Duration, context: &Context) -> Result<(), Error> {
    let remote = SharedStore::open(context, args.remote.as_ref().and_then(Option::as_deref))?;
    let options = GcOptions {
        keep_last: args.keep_last,
        grace,
        dry_run: args.dry_run,
    };
    let done = remote.gc(options)?;
    if args.record.json {
        return print_json(&json!({"dry_run": args.dry_run, "collected": done, "traffic": remote.traffic()}));
    }
    let would = if args.dry_run { "would remove" } else { "removed" };
    print_line(&format!(
        "{would} {}, {} records, {} large blobs, {} packs: {}, kept {} ({} packs rewritten), {}",
        count(done.runs as usize, "run"),
        done.records,
        done.blobs,
        done.packs,
        size(done.removed_bytes),
        size(done.kept_bytes),
        done.new_packs,
        traffic_text(remote.traffic()),
    ));
    if done.missing > 0 {
        context.warn(format!(
            "{} results that kept runs name are missing. `marf cache fsck --remote` lists the objects that refer to them",
            done.missing
        ));
    }
    Ok(())
}

/// `marf cache fsck --remote`: verifies the shared store.
pub fn fsck(args: &FsckArgs, context: &Context) -> Result<(), Error> {
    let remote = SharedStore::open(context, args.remote.as_ref().and_then(Option::as_deref))?;
    let options = FsckOptions {
        read_data: args.read_data.unwrap_or_default(),
        repair: args.repair,
    };
    let checked = remote.fsck(options)?;
    if args.record.json {
        print_json(&checked)?;
    } else {
        for fault in &checked.faults {
            print_line(&format!("{}: {}", fault.object, fault.what));
        }
        print_line(&format!(
            "{} blobs, {} records, {}, {} read, {}",
            checked.blobs,
            checked.records,
            count(checked.runs as usize, "run"),
            size(checked.read_bytes),
            count(checked.faults.len(), "fault")
        ));
    }
    if checked.faults.is_empty() {
        return Ok(());
    }
    if checked.is_repaired {
        eprint_line(
            "repaired: damaged files and everything that refers to them are removed. The next push sends them again",
        );
        return Ok(());
    }
    Err(Error::Failed(
        Diagnostic::new(format!("{} has {}", remote.place(), count(checked.faults.len(), "fault"))).hint(
            "`marf cache fsck --remote --repair` removes them. `marf cache push` from a machine that has the results sends them again",
        ),
    ))
}
