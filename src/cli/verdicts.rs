//! The verdicts of a chain of filters, one line a file.

use std::collections::BTreeMap;

use marf_engine::RunRecord;
use marf_stage::{VERDICTS, Verdict};

use super::error::CliError;
use super::files::csv_field;
use super::session::Session;

/// Verdict of files that are no photos (labels, notes): they are not judged.
const SKIPPED: &str = "skipped";

/// Returns the verdicts of every node that judged, by the node's name.
///
/// # Errors
/// Verdicts that the store has lost.
pub fn by_node(session: &Session, record: &RunRecord) -> Result<BTreeMap<String, Vec<Verdict>>, CliError> {
    let judged = record
        .nodes
        .iter()
        .filter_map(|node| Some((node.name.clone(), node.outputs.get(VERDICTS)?)));
    judged
        .map(|(name, output)| Ok((name, parse(&session.store.get(&output.digest)?)?)))
        .collect()
}

/// Returns all verdicts of a run that can still be read.
pub fn all(session: &Session, record: &RunRecord) -> Vec<Verdict> {
    let by_node = by_node(session, record).unwrap_or_default();
    by_node.into_values().flatten().collect()
}

/// Returns one verdict a photo, by file name: of the filter of the chain that rejected it, else of the last one. A
/// photo that a person kept against a filter says so.
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

fn parse(bytes: &[u8]) -> Result<Vec<Verdict>, CliError> {
    let lines = bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
    lines
        .map(|line| {
            serde_json::from_slice(line).map_err(|error| CliError::failed(format!("verdicts: {error}")))
        })
        .collect()
}

/// Returns the CSV: file, verdict, score, threshold, twin, reason.
pub fn csv(verdicts: &[Verdict]) -> String {
    let number = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
    let mut text = String::from("file,verdict,score,threshold,twin,reason\n");
    for verdict in verdicts {
        let fields = [
            csv_field(&verdict.file),
            csv_field(&verdict.verdict),
            number(verdict.score),
            number(verdict.threshold),
            csv_field(verdict.twin.as_deref().unwrap_or_default()),
            csv_field(&verdict.reason),
        ];
        text.push_str(&fields.join(","));
        text.push('\n');
    }
    text
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
            csv(&[verdict]),
            "file,verdict,score,threshold,twin,reason\n\"x/a,b.png\",blur,6.25,10,,\"ratio 6.25, at least 10\"\n"
        );
    }
}
