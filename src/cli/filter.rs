use std::collections::BTreeMap;
use std::path::Path;

use marf_engine::Cancel;

use super::args::Global;
use super::error::CliError;
use super::run::{execute, options};
use super::session::Session;
use super::{files, say_json, verdicts};

/// The chain of `marf filter`, with every filter's own defaults.
const CHAIN: [&str; 7] = [
    "extract",
    "size",
    "shape",
    "duplicate",
    "grayscale",
    "histogram",
    "blur",
];

/// `marf filter DIR`: judges the photos of a folder.
pub fn filter(global: &Global, dir: &Path, out: &Path, cancel: &Cancel) -> Result<(), CliError> {
    let session = Session::implicit(&pipeline(dir), global)?;
    let (record, ended) = execute(&session, &options(global, &session.name), global, cancel)?;
    let judged = verdicts::merged(&session, &record, &CHAIN)?;
    if !judged.is_empty() {
        files::write(out, verdicts::csv(&judged).as_bytes())?;
    }
    ended?;
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for verdict in &judged {
        *counts.entry(&verdict.verdict).or_default() += 1;
    }
    if global.json {
        return say_json(&counts);
    }
    for (name, count) in &counts {
        crate::say(&format!("{name:<12} {count}"));
    }
    crate::talk(&format!("wrote {}", out.display()));
    Ok(())
}

fn pipeline(dir: &Path) -> String {
    let mut text = format!("name = \"filter\"\n{}", folder(dir));
    for pair in CHAIN.windows(2) {
        text.push_str(&format!("[node.{}]\ninput = \"{}\"\n", pair[1], pair[0]));
    }
    text
}

/// Returns the archive and the extract node of a folder.
pub fn folder(dir: &Path) -> String {
    let path = toml::Value::String(dir.to_string_lossy().into_owned());
    format!("[archive.folder]\nkind = \"folder\"\npath = {path}\n[node.extract]\narchive = \"folder\"\n")
}
