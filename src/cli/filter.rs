use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use marf_engine::{Cancel, RunRecord, document};
use marf_stage::Verdict;

use super::args::{FilterArgs, Global};
use super::documents::{self, Documents};
use super::error::CliError;
use super::output::print_json;
use super::run::{Execution, execute_as, options};
use super::session::Session;
use super::{export, folder, report, verdicts};
use marf_report::{FACTORS, calls, percent};
use crate::terminal::{eprint_line, print_line};

/// Returns the nodes of `marf filter` in their order: extract, then every filter of the table.
fn chain() -> Vec<&'static str> {
    let filters = marf_stages::filters().iter().map(|filter| filter.name);
    std::iter::once("extract").chain(filters).collect()
}

/// Runs `marf filter DIR`: every filter with its defaults on the photos of a folder.
pub fn filter(global: &Global, args: &FilterArgs, cancel: &Cancel) -> Result<(), CliError> {
    let chain = chain();
    let session = Session::implicit(&pipeline(&chain, args), global, cancel)?;
    let execution = Execution {
        trace: None,
        documents: &|record| documents(&session, record, &chain),
    };
    let options = options(global, &session.name);
    let (record, ended) = execute_as(&session, &options, global, cancel, &execution)?;
    let by_node = verdicts::by_node(&session, &record)?;
    let merged = verdicts::merged(&by_node, &chain);
    for (name, path) in [
        (document::VERDICTS, args.out.clone()),
        (document::REPORT, page(&args.out)),
    ] {
        if let Some(document) = record.documents.get(name) {
            export::one(&session, &record, &document.digest, &path)?;
        }
    }
    ended?;
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for verdict in &merged {
        *counts.entry(&verdict.verdict).or_default() += 1;
    }
    if global.json {
        return print_json(&counts);
    }
    for (name, count) in &counts {
        print_line(&format!("{name:<12} {count}"));
    }
    eprint_line(&changed_by_thresholds(&by_node, &chain));
    eprint_line(&format!(
        "wrote {} and {}",
        args.out.display(),
        page(&args.out).display()
    ));
    Ok(())
}

/// Stores the table of the verdicts and the page that shows them; nothing where there is no verdict.
fn documents(session: &Session, record: &RunRecord, chain: &[&str]) -> Result<Documents, CliError> {
    let merged = verdicts::merged(&verdicts::by_node(session, record)?, chain);
    if merged.is_empty() {
        return Ok(Documents::new());
    }
    let mut documents = report::documents(session, record)?;
    let (name, csv) = documents::put(session, document::VERDICTS, &verdicts::csv(&merged)?)?;
    documents.insert(name, csv);
    Ok(documents)
}

/// Returns the path of the page of the verdicts, beside the CSV.
fn page(csv: &Path) -> PathBuf {
    csv.with_extension("html")
}

/// Returns a table of how many verdicts of each filter would change at other thresholds.
fn changed_by_thresholds(by_node: &BTreeMap<String, Vec<Verdict>>, chain: &[&str]) -> String {
    let heads: Vec<String> = FACTORS
        .iter()
        .map(|factor| format!("{:>7}", percent(factor - 1.0)))
        .collect();
    let mut lines = vec![format!("{:<12} {}", "threshold", heads.concat())];
    for name in chain {
        let calls = by_node
            .get(*name)
            .map(|verdicts| calls(verdicts))
            .unwrap_or_default();
        let flips = |factor: f64| calls.iter().filter(|call| call.flips_at(factor)).count();
        if !calls.is_empty() {
            let cells: Vec<String> = FACTORS
                .iter()
                .map(|factor| format!("{:>7}", flips(*factor)))
                .collect();
            lines.push(format!(
                "{name:<12} {} of {} verdicts change",
                cells.concat(),
                calls.len()
            ));
        }
    }
    lines.join("\n")
}

/// Returns the text of the pipeline that runs a chain of nodes on the folder of `args`.
fn pipeline(chain: &[&str], args: &FilterArgs) -> String {
    let mut text = folder::photos("filter", &args.dir);
    for pair in chain.windows(2) {
        text.push_str(&format!("[node.{}]\ninput = \"{}\"\n", pair[1], pair[0]));
    }
    for (list, ids) in [("keep", &args.keep), ("reject", &args.reject)] {
        if !ids.is_empty() {
            let ids = toml::Value::from(ids.clone());
            text.push_str(&format!("[{list}]\nids = {ids}\n"));
        }
    }
    text
}
