//! `marf audit`: who made a file, from which bytes; and what a product went into.

mod changed;
mod from;
pub mod identity;
mod in_crate;
mod lineage;
mod tree;

use std::path::{Path, PathBuf};

use clap::Args;
use marf_engine::Cancel;
use marf_provenance::{
    lineage::Lineage,
    verify::{self, Verified},
};
use serde::Serialize;

use self::{
    changed::Changed,
    identity::{Identity, identify},
    lineage::{Origin, origin_of},
};
use super::args::Global;
use super::error::{Answer, CliError, Diagnostic};
use super::output::print_json;
use super::session::{existing_store, warn};
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

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Report<'a> {
    file: &'a Path,
    answer: Answer,
    #[serde(flatten)]
    identity: &'a Identity,
    lineage: &'a [Origin],
    #[serde(skip_serializing_if = "Option::is_none")]
    verified: Option<&'a Verified>,
    #[serde(skip_serializing_if = "<[Changed]>::is_empty")]
    changed: &'a [Changed],
}

/// `marf audit`: who made a file, from which bytes.
pub fn audit(global: &Global, args: &AuditArgs, cancel: &Cancel) -> Result<(), CliError> {
    match (&args.path, &args.in_crate, &args.from) {
        (Some(file), Some(folder), _) => in_crate::in_crate(global, file, folder),
        (Some(file), None, _) => audit_file(global, args, file, cancel),
        (None, _, Some(product)) => from::from(global, product, cancel),
        (None, _, None) => Err(CliError::usage(
            "name a file, or a product with --from".to_owned(),
        )),
    }
}

fn audit_file(global: &Global, args: &AuditArgs, file: &Path, cancel: &Cancel) -> Result<(), CliError> {
    let bytes = std::fs::read(file)
        .map_err(|error| CliError::failed(format!("cannot read {}: {error}", file.display())))?;
    let store = existing_store(global, cancel)?;
    let check = args.verify.then(|| verify::check(&store)).transpose()?;
    let runs = marf_engine::runs(&store, warn)?;
    let identity = identify(&store, &runs, &bytes)?;
    let (mut lineages, mut changed) = (Vec::new(), Vec::new());
    let mut verified = check.as_ref().map(Verified::of_files);
    for maker in identity.makers() {
        let number = maker.made_in.or(maker.runs.first().copied());
        let Some(run) = runs.iter().find(|run| Some(run.number) == number) else {
            continue;
        };
        let whole = Lineage::of(&store, run.clone())?;
        let nodes = match maker.place.node() {
            Some(node) => whole.upstream(node),
            None => whole.nodes.iter().collect(),
        };
        lineages.push(origin_of(&whole, maker, &nodes, args.products)?);
        if let Some(check) = &check {
            let found = verify::verify(&whole, &nodes, check)?;
            verified = verified.map(|before| before.and(found));
            changed.extend(changed::since(global, &whole, &nodes)?);
        }
    }
    let answer = answer(&identity, &lineages, verified.as_ref(), &changed);
    let report = Report {
        file,
        answer,
        identity: &identity,
        lineage: &lineages,
        verified: verified.as_ref(),
        changed: &changed,
    };
    match global.json {
        true => print_json(&report)?,
        false => print_line(escape_control(&tree::text(&report)).trim_end()),
    }
    told(answer, file)
}

/// Returns the answer: the first of altered, incomplete, changed that holds.
fn answer(
    identity: &Identity,
    lineages: &[Origin],
    verified: Option<&Verified>,
    changed: &[Changed],
) -> Answer {
    let has_faults = verified.is_some_and(|verified| !verified.faults.is_empty());
    let has_lost = verified.is_some_and(|verified| !verified.missing.is_empty());
    match identity {
        _ if has_faults => Answer::Altered,
        Identity::NotOurs { .. } => Answer::NotOurs,
        Identity::Altered { .. } => Answer::Altered,
        Identity::Elsewhere { .. } => Answer::Incomplete,
        Identity::Whole { .. } if has_lost || lineages.iter().any(Origin::is_incomplete) => {
            Answer::Incomplete
        }
        Identity::Whole { .. } if !changed.is_empty() => Answer::Changed,
        Identity::Whole { .. } => Answer::Whole,
    }
}

/// Ends the verb with the code of the answer.
fn told(answer: Answer, file: &Path) -> Result<(), CliError> {
    let file = file.display();
    let said = |message: String| Err(CliError::Answered(answer, Diagnostic::new(message)));
    match answer {
        // The last two are answers of a replay.
        Answer::Whole | Answer::Differs | Answer::NotMade => Ok(()),
        Answer::NotOurs => said(format!("{file} was not made by a run of this store")),
        Answer::Altered => said(format!("{file}, or something that it was made from, was altered")),
        Answer::Incomplete => said(format!("not all of what {file} was made from is in the store")),
        Answer::Changed => said(format!("an archive has changed a product of {file} since")),
    }
}
