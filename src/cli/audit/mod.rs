//! `marf audit`: traces a file's provenance, or lists everything derived from a product.

mod sentence;
mod tree;
mod uses;

use std::path::PathBuf;

use clap::Args;
use marf_run::audit::{self, AuditRequest, CrateTrace, Detail};
use marf_run::{Context, Error};

use super::options::RecordArgs;
use super::output::print_json;
use crate::terminal::print_lines;

/// Arguments of `audit`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct AuditArgs {
    /// File to trace
    #[arg(
        value_name = "FILE",
        required_unless_present = "from",
        conflicts_with = "from"
    )]
    pub path: Option<PathBuf>,
    /// Re-read everything the file was made from, and compare digests
    #[arg(long)]
    pub verify: bool,
    /// List every step, input, product and digest, not only the first few
    #[arg(long, conflicts_with = "from")]
    pub all: bool,
    /// Use a crate of `export crate` instead of the store
    #[arg(long = "crate", value_name = "CRATE", conflicts_with_all = ["from", "verify"])]
    pub in_crate: Option<PathBuf>,
    /// List everything derived from a product (id, file name or blake3)
    #[arg(long, value_name = "PRODUCT")]
    pub from: Option<String>,
    #[command(flatten)]
    record: RecordArgs,
}

const AFTER_HELP: &str = "\
Exit codes: 0 written by marf and unaltered, 3 not written by marf, 4 altered, 5 the store no longer has a part of its lineage, 6 an \
archive has changed a product since.";

/// `marf audit`: who made a file, from which bytes.
pub fn audit(args: AuditArgs, context: Context) -> Result<(), Error> {
    let (context, record) = (&args.record.store.context(context), &args.record);
    let detail = if args.all { Detail::All } else { Detail::Short };
    match (args.path, args.in_crate, args.from) {
        (Some(file), Some(folder), _) => {
            in_crate(record, &audit::trace(&file, &folder, &context.cancel)?, detail)
        }
        (Some(file), None, _) => {
            let request = AuditRequest {
                file,
                verify: args.verify,
                detail,
            };
            audit_file(record, &request, context)
        }
        (None, _, Some(product)) => from(record, &product, context),
        (None, _, None) => Err(Error::usage("name a file, or a product with --from".to_owned())),
    }
}

fn audit_file(record: &RecordArgs, request: &AuditRequest, context: &Context) -> Result<(), Error> {
    let report = audit::audit(context, request)?;
    if record.json {
        print_json(&report)?;
    } else {
        print_lines(tree::text(&report, request.detail));
    }
    audit::is_whole(report.answer, &report.file)
}

/// Prints the origin of a file from the run of a crate.
fn in_crate(record: &RecordArgs, found: &CrateTrace, detail: Detail) -> Result<(), Error> {
    if record.json {
        return print_json(found);
    }
    print_lines(tree::crate_text(&found.trace, detail));
    Ok(())
}

/// Prints every run and node that a product went into, the newest run first.
fn from(record: &RecordArgs, product: &str, context: &Context) -> Result<(), Error> {
    let uses = audit::uses(context, product)?;
    if record.json {
        print_json(&uses)?;
    } else {
        uses.runs
            .iter()
            .for_each(|tainted| print_lines(uses::text(tainted)));
    }
    uses.is_whole()
}
