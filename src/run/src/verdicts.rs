//! The verdicts of the filters of a run, and their CSV.

use std::collections::BTreeMap;

use marf_config::scenes::scene_of;
use marf_engine::RunRecord;
use marf_model::Run;
use marf_report::{Figure, Report};
use marf_stage::{VERDICTS, Verdict};

use crate::error::Error;
use crate::report_memos::StoreMemos;
use crate::session::Session;

/// Verdict of files that are not photos (labels, notes). No filter sees them.
const SKIPPED: &str = "skipped";

/// Returns the verdicts of every node that has some, by the node's name.
///
/// # Errors
/// Verdicts that cannot be read from the store.
pub fn by_node(session: &Session, record: &RunRecord) -> Result<BTreeMap<String, Vec<Verdict>>, Error> {
    let outputs = record
        .nodes
        .iter()
        .filter_map(|node| Some((node.name.clone(), node.outputs.get(VERDICTS)?)));
    outputs
        .map(|(name, output)| Ok((name, session.verdicts(&output.digest)?)))
        .collect()
}

/// Returns all verdicts of a run that can still be read.
pub fn all(session: &Session, record: &RunRecord) -> Vec<Verdict> {
    let by_node = by_node(session, record).unwrap_or_default();
    by_node.into_values().flatten().collect()
}

/// Returns one line for each camera whose photos a run keeps as photos of another kind.
///
/// # Errors
/// A store that cannot be read.
pub fn kept_as(session: &Session, record: &RunRecord) -> Result<Vec<String>, Error> {
    of_report(session, record, marf_report::kept_as)
}

/// Returns the figures of the first screen of a run's report.
///
/// # Errors
/// A store that cannot be read.
pub fn summary(session: &Session, record: &RunRecord) -> Result<Vec<Figure>, Error> {
    of_report(session, record, marf_report::summary)
}

/// Returns what a report of all nodes that are of no scene says.
fn of_report<T>(
    session: &Session,
    record: &RunRecord,
    make: impl FnOnce(&Report<'_>) -> T,
) -> Result<T, Error> {
    let run = Run::new(&session.store, record.clone())?;
    Ok(make(&Report {
        changes: None,
        trade: None,
        read: &|digest| session.store.get(digest).ok(),
        memos: &StoreMemos(&session.store, None),
        run: &run,
        started: String::new(),
        scene: None,
        nodes: run
            .nodes
            .iter()
            .filter(|node| !node.is_child() && scene_of(&node.run.name).is_none())
            .collect(),
        scenes: Vec::new(),
        params: &BTreeMap::new(),
    }))
}

/// Returns one verdict for each photo, sorted by file: that of the filter that rejected it, else that of the last
/// filter of the chain. Where a person kept a photo against a filter, that filter's verdict says so.
pub fn merged(by_node: &BTreeMap<String, Vec<Verdict>>, chain: &[&str]) -> Vec<Verdict> {
    let mut by_id: BTreeMap<&str, &Verdict> = BTreeMap::new();
    for verdict in chain.iter().filter_map(|name| by_node.get(*name)).flatten() {
        let overruled = by_id
            .get(verdict.id.as_str())
            .is_some_and(|earlier| earlier.reason.starts_with("kept by hand, against"));
        if !(overruled && verdict.keeps()) {
            by_id.insert(&verdict.id, verdict);
        }
    }
    let mut verdicts: Vec<Verdict> = by_id
        .into_values()
        .filter(|verdict| verdict.verdict != SKIPPED)
        .cloned()
        .collect();
    verdicts.sort_by(|a, b| a.file.cmp(&b.file));
    verdicts
}

/// Returns the verdicts as CSV: file, verdict, score, threshold, twin, reason.
///
/// # Errors
/// An error of the CSV writer.
pub fn csv(verdicts: &[Verdict]) -> Result<Vec<u8>, Error> {
    let number = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
    let failed = |error: String| Error::failed(format!("verdicts: {error}"));
    let mut writer = csv::Writer::from_writer(Vec::new());
    let heads = ["file", "verdict", "score", "threshold", "twin", "reason"].map(str::to_owned);
    let lines = verdicts.iter().map(|verdict| {
        [
            verdict.file.clone(),
            verdict.verdict.clone(),
            number(verdict.score),
            number(verdict.threshold),
            verdict.twin.clone().unwrap_or_default(),
            verdict.reason.clone(),
        ]
    });
    for line in std::iter::once(heads).chain(lines) {
        writer
            .write_record(line)
            .map_err(|error| failed(error.to_string()))?;
    }
    writer.into_inner().map_err(|error| failed(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_csv_has_a_line_a_verdict_and_empty_fields_where_nothing_is_known() {
        let verdict = Verdict {
            id: "a".into(),
            file: "x/a,b.png".into(),
            verdict: "blur".into(),
            score: Some(6.25),
            threshold: Some(10.0),
            twin: None,
            reason: "ratio 6.25, at least 10".into(),
        };
        assert_eq!(
            String::from_utf8(csv(&[verdict]).unwrap()).unwrap(),
            "file,verdict,score,threshold,twin,reason\n\"x/a,b.png\",blur,6.25,10,,\"ratio 6.25, at least 10\"\n"
        );
    }
}
