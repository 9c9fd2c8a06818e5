//! `marf audit --from`: what a product went into.

use marf_engine::Cancel;
use marf_provenance::lineage::Lineage;
use marf_provenance::taint::{Tainted, product_of, tainted};
use marf_provenance::unless_lost;

use crate::cli::args::Global;
use crate::cli::error::{Answer, CliError, Diagnostic};
use crate::cli::output::print_json;
use crate::cli::session::{existing_store, warn};
use crate::terminal::{escape_control, print_line};

/// Prints every run and node that a product went into, the newest run first.
///
/// # Errors
/// A store that cannot be read; a product that no run read, which is the answer "not ours".
pub fn from(global: &Global, wanted: &str, cancel: &Cancel) -> Result<(), CliError> {
    let store = existing_store(global, cancel)?;
    let (mut found, mut lost): (Vec<Tainted>, Vec<u64>) = (Vec::new(), Vec::new());
    for run in marf_engine::runs(&store, warn)?.into_iter().rev() {
        let number = run.number;
        let lineage = Lineage::of(&store, run)?;
        let answer = || match product_of(&lineage, wanted)? {
            Some(product) => tainted(&lineage, &product),
            None => Ok(None),
        };
        match unless_lost(answer())? {
            Some(tainted) => found.extend(tainted),
            None => lost.push(number),
        }
    }
    match global.json {
        true => print_json(&serde_json::json!({"product": wanted, "runs": found, "lost_runs": lost}))?,
        false => found
            .iter()
            .for_each(|tainted| print_line(&escape_control(&text(tainted)))),
    }
    let said = |answer, message: String| Err(CliError::Answered(answer, Diagnostic::new(message)));
    if !lost.is_empty() {
        let runs: Vec<String> = lost.iter().map(ToString::to_string).collect();
        return said(
            Answer::Incomplete,
            format!(
                "objects of runs {} are not in the store any more",
                runs.join(", ")
            ),
        );
    }
    match found.is_empty() {
        true => said(
            Answer::NotOurs,
            format!("no run of this store read a product `{wanted}`"),
        ),
        false => Ok(()),
    }
}

fn text(tainted: &Tainted) -> String {
    let mut lines = vec![format!("run {}: {}", tainted.run, tainted.command)];
    for node in &tainted.nodes {
        let outputs: Vec<&str> = node.outputs.keys().map(String::as_str).collect();
        let shown = outputs.len().min(MOST_OUTPUTS);
        let more = match outputs.len() - shown {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        lines.push(format!(
            "  {:<22} through {:<16} into {}{more}",
            node.node,
            node.through.join(", "),
            outputs[..shown].join(", ")
        ));
    }
    match tainted.rejected_by.as_slice() {
        [] => {}
        by => lines.push(format!(
            "  rejected by {}: what follows does not hold it",
            by.join(", ")
        )),
    }
    lines.join("\n")
}

/// Most outputs of a node that are named in its line.
const MOST_OUTPUTS: usize = 4;
