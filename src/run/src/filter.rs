//! Filters the photos of a folder.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use marf_engine::{RunRecord, SilentListener, document};
use marf_report::calls;
use marf_stage::Verdict;

use crate::context::Context;
use crate::documents::{self, Documents};
use crate::error::{Diagnostic, Error};
use crate::execute::{Extras, execute_with, options};
use crate::session::Session;
use crate::{folder, outputs, report, verdicts};

/// The verdicts on the photos of a folder.
#[derive(Debug, Clone)]
pub struct FilterResult {
    /// How many photos have each verdict.
    pub counts: BTreeMap<String, usize>,
    /// The filters that judged by a threshold, in the order of the chain.
    pub filters: Vec<FilterCalls>,
    /// The page with the photos.
    pub page: PathBuf,
}

/// How firm the verdicts of a filter are.
#[derive(Debug, Clone)]
pub struct FilterCalls {
    /// The filter.
    pub name: String,
    /// Its verdicts by a threshold.
    pub verdicts: Vec<Verdict>,
}

/// Runs every filter with its defaults on the photos of a folder. Writes their verdicts to `csv`, and a page with the photos next to it.
/// `keep` and `reject` list product ids or file names of photos to keep or to reject whatever the filters decide.
///
/// # Errors
/// A folder that cannot be read, a place that cannot be written, a run that fails.
pub fn filter(
    context: &Context,
    dir: &Path,
    csv: &Path,
    keep: &[String],
    reject: &[String],
) -> Result<FilterResult, Error> {
    let chain = chain();
    let session = Session::implicit(context, &pipeline(&chain, dir, keep, reject), "filter", dir)?;
    let extras = Extras {
        documents: &|record| documents(&session, record, &chain),
        listener: &SilentListener,
    };
    let execution = execute_with(&session, &options(&session), &extras)?;
    let by_node = verdicts::by_node(&session, &execution.record)?;
    let merged = verdicts::merged(&by_node, &chain);
    let page = csv.with_extension("html");
    for (name, path) in [(document::VERDICTS, csv), (document::REPORT, &page)] {
        if let Some(document) = execution.record.documents.get(name) {
            outputs::one(&session.store, &execution.record, &document.digest, path)?;
        }
    }
    execution.done().map_err(folder::for_folder)?;
    if merged.is_empty() {
        let diagnostic = Diagnostic::new(format!("{} has no photo", dir.display()));
        return Err(Error::Failed(
            diagnostic.hint("name the folder that holds the photos"),
        ));
    }
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for verdict in merged {
        *counts.entry(verdict.verdict).or_default() += 1;
    }
    let calls_of = |name: &&str| {
        let verdicts = by_node.get(*name)?;
        (!calls(verdicts).is_empty()).then(|| FilterCalls {
            name: (*name).to_owned(),
            verdicts: verdicts.clone(),
        })
    };
    let filters = chain.iter().filter_map(calls_of).collect();
    Ok(FilterResult {
        counts,
        filters,
        page,
    })
}

/// Returns the nodes of the pipeline in their order: extract, then every filter of the table.
fn chain() -> Vec<&'static str> {
    let filters = marf_stages::filters().iter().map(|filter| filter.name);
    std::iter::once("extract").chain(filters).collect()
}

/// Stores the table of the verdicts and the page that shows them. Stores nothing without a verdict.
fn documents(session: &Session, record: &RunRecord, chain: &[&str]) -> Result<Documents, Error> {
    let merged = verdicts::merged(&verdicts::by_node(session, record)?, chain);
    if merged.is_empty() {
        return Ok(Documents::new());
    }
    let mut documents = report::documents(session, record)?;
    let (name, csv) = documents::put(session, document::VERDICTS, &verdicts::csv(&merged)?)?;
    documents.insert(name, csv);
    Ok(documents)
}

/// Returns the text of the pipeline that runs a chain of nodes on a folder, with lists of photos to keep and to reject.
fn pipeline(chain: &[&str], dir: &Path, keep: &[String], reject: &[String]) -> String {
    let mut text = folder::photos("filter", dir);
    for pair in chain.windows(2) {
        text.push_str(&format!("[node.{}]\ninput = \"{}\"\n", pair[1], pair[0]));
    }
    for (list, ids) in [("keep", keep), ("reject", reject)] {
        if !ids.is_empty() {
            let ids = toml::Value::from(ids.to_vec());
            text.push_str(&format!("[{list}]\nids = {ids}\n"));
        }
    }
    text
}
