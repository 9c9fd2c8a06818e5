//! Runs the six filters with their default rules over a folder and writes the verdicts as CSV.
//!
//! usage: bench FOLDER VERDICTS.csv [NAME={"param": value}]...
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "an example that a person runs"
)]

use std::{collections::BTreeMap, fmt::Write as _, fs, path::Path, time::Instant};

use marf_cache::manifest::Row;
use marf_filter::STAGES;
use marf_scene::{Photo, PhotoFacts};
use marf_stage::{Measured, Verdict, Work, harness::Harness};

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [folder, out, params @ ..] = args.as_slice() else {
        eprintln!("usage: bench FOLDER VERDICTS.csv [NAME=JSON]...");
        return;
    };
    let params: BTreeMap<&str, &str> = params.iter().filter_map(|arg| arg.split_once('=')).collect();
    let harness = Harness::default();
    let mut verdicts = Vec::new();
    let mut rows = read(Path::new(folder), &harness, &mut verdicts);
    for stage in STAGES {
        let start = Instant::now();
        let params = params.get(stage.name).map_or("{}", |params| params);
        let bound = (stage.bind)(serde_json::from_str(params).unwrap()).unwrap();
        let judged = judge(&bound.work(), &harness, &rows);
        let before = rows.len();
        rows.retain(|row| {
            judged
                .iter()
                .any(|verdict| verdict.id == row.id && verdict.keeps())
        });
        let seconds = start.elapsed().as_secs_f64();
        println!(
            "{:10} {before:4} -> {:4}  {:5.1} photos/s",
            stage.name,
            rows.len(),
            before as f64 / seconds
        );
        let last = stage.name == "blur";
        verdicts.extend(judged.into_iter().filter(|verdict| last || !verdict.keeps()));
    }
    verdicts.sort_by(|a, b| a.file.cmp(&b.file));
    fs::write(out, csv(&verdicts)).unwrap();
}

fn read(folder: &Path, harness: &Harness, verdicts: &mut Vec<Verdict>) -> Vec<Row> {
    let mut rows = Vec::new();
    let mut paths: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.sort();
    for path in paths
        .iter()
        .filter(|path| path.extension().is_some_and(|end| end != "json"))
    {
        let id = path.file_name().unwrap().to_string_lossy().into_owned();
        let bytes = fs::read(path).unwrap();
        match Photo::decode(&bytes) {
            Ok(photo) => {
                let facts = PhotoFacts {
                    file: id.clone(),
                    size_bytes: bytes.len() as u64,
                    width: photo.image.width,
                    height: photo.image.height,
                    bands: photo.bands,
                    ..PhotoFacts::default()
                };
                let blobs = BTreeMap::from([("image".to_owned(), harness.put(&bytes))]);
                rows.push(Row {
                    id,
                    blobs,
                    facts: facts.to_json(),
                });
            }
            Err(error) => verdicts.push(Verdict {
                file: id.clone(),
                id,
                verdict: "decode".to_owned(),
                score: None,
                threshold: None,
                twin: None,
                reason: error.to_string(),
            }),
        }
    }
    rows
}

fn judge(work: &Work<'_>, harness: &Harness, rows: &[Row]) -> Vec<Verdict> {
    let measure: &dyn marf_stage::Measure = match work {
        Work::Map(map) => *map,
        Work::Fold(fold) => *fold,
        _ => unreachable!("a filter is a map or a fold"),
    };
    let measures: Vec<Vec<u8>> = rows
        .iter()
        .map(|row| measure.measure(&harness.ctx(), row).unwrap())
        .collect();
    let items: Vec<Measured<'_>> = rows
        .iter()
        .zip(&measures)
        .map(|(row, measure)| Measured {
            shard: 0,
            row,
            measure,
        })
        .collect();
    match work {
        Work::Map(map) => map.decide(&items).unwrap(),
        Work::Fold(fold) => fold.fold(None, &items).unwrap().1,
        _ => unreachable!("a filter is a map or a fold"),
    }
}

fn csv(verdicts: &[Verdict]) -> String {
    let mut text = "file,verdict,score,threshold,twin,reason\n".to_owned();
    for verdict in verdicts {
        let number = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.5}"));
        let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
        let (score, threshold) = (number(verdict.score), number(verdict.threshold));
        let twin = quoted(verdict.twin.as_deref().unwrap_or_default());
        let (file, reason) = (quoted(&verdict.file), quoted(&verdict.reason));
        let _ = writeln!(
            text,
            "{file},{},{score},{threshold},{twin},{reason}",
            verdict.verdict
        );
    }
    text
}
