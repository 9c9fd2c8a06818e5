//! `marf audit`: who made a file, from which bytes; and what a product went into.

mod tree;
mod uses;

use std::path::{Path, PathBuf};

use clap::Args;
use marf_engine::Cancel;
use marf_run::audit::{self, AuditRequest};
use marf_run::{Context, Error};
use serde_json::json;

use super::global::Global;
use super::output::print_json;
use crate::terminal::{escape_control, print_line};

/// Arguments of `audit`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct AuditArgs {
    /// A file that marf may have made, wherever it lies now
    #[arg(
        value_name = "FILE",
        required_unless_present = "from",
        conflicts_with = "from"
    )]
    pub path: Option<PathBuf>,
    /// Read everything that it was made from, and compare it with its digests
    #[arg(long)]
    pub verify: bool,
    /// List all products of archives, not the first few
    #[arg(long)]
    pub products: bool,
    /// Ask a crate of `export crate` instead of a store
    #[arg(long = "crate", value_name = "CRATE", conflicts_with_all = ["from", "verify"])]
    pub in_crate: Option<PathBuf>,
    /// Tell what a product (id, name of its file, or blake3) went into
    #[arg(long, value_name = "PRODUCT")]
    pub from: Option<String>,
}

const AFTER_HELP: &str = "\
Exit codes of the answer: 0 made by marf and whole, 3 not made by marf, 4 altered, 5 something of its lineage is not in \
the store any more, 6 an archive has changed a product since.";

/// `marf audit`: who made a file, from which bytes.
pub fn audit(global: &Global, args: AuditArgs, context: &Context) -> Result<(), Error> {
    match (args.path, args.in_crate, args.from) {
        (Some(file), Some(folder), _) => in_crate(global, &file, &folder, &context.cancel),
        (Some(file), None, _) => {
            let request = AuditRequest {
                file,
                verify: args.verify,
                products: args.products,
            };
            audit_file(global, &request, context)
        }
        (None, _, Some(product)) => from(global, &product, context),
        (None, _, None) => Err(Error::usage("name a file, or a product with --from".to_owned())),
    }
}

fn audit_file(global: &Global, request: &AuditRequest, context: &Context) -> Result<(), Error> {
    let report = audit::audit(context, request)?;
    if global.json {
        print_json(&report)?;
    } else {
        print_line(escape_control(&tree::text(&report)).trim_end());
    }
    audit::is_whole(report.answer, &report.file)
}

/// Prints what the run of a crate says of a file.
fn in_crate(global: &Global, file: &Path, folder: &Path, cancel: &Cancel) -> Result<(), Error> {
    let trace = audit::trace(file, folder, cancel)?;
    if global.json {
        return print_json(&trace);
    }
    print_line(escape_control(&trace.to_string()).trim_end());
    Ok(())
}

/// Prints every run and node that a product went into, the newest run first.
fn from(global: &Global, product: &str, context: &Context) -> Result<(), Error> {
    let uses = audit::uses(context, product)?;
    if global.json {
        print_json(&json!(uses))?;
    } else {
        uses.runs
            .iter()
            .for_each(|tainted| print_line(&escape_control(&uses::text(tainted))));
    }
    uses.is_whole()
}
