//! Writes the outputs of a run to `OUT/<node>/<file>`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

use marf_cache::{Digest, Store};
use marf_engine::{RunRecord, document, sets};
use marf_model::select;
use marf_schema::changes::ChangesReport;
use marf_schema::scenes::Scenes;
use marf_schema::ties::Ties;
use marf_schema::{output, train, tune};
use marf_stage::{Document, VERDICTS};

use crate::choice::subject;
use crate::context::Context;
use crate::copies;
use crate::error::{Diagnostic, Error};
use crate::export_table::ExportTable;
use crate::files;
use crate::scenes::{self, SCENE_PAGES};
use crate::session::Session;
use crate::status::newest_run;

/// Outputs without a file name of their own, and the name they get.
const NAMED: [(&str, &str); 13] = [
    (Scenes::OUTPUT, "scenes.json"),
    (Ties::OUTPUT, "ties.json"),
    (output::SCENE, "scene.json"),
    (output::TRANSFORMS, "transforms.json"),
    (train::Metrics::OUTPUT, "metrics.json"),
    (output::WEIGHTS, "weights.safetensors"),
    (train::Curve::OUTPUT, "curve.json"),
    (train::Setup::OUTPUT, "setup.json"),
    (tune::BestParams::OUTPUT, "params.json"),
    (tune::Trials::OUTPUT, "trials.json"),
    (tune::Scatter::OUTPUT, "scatter.json"),
    (output::VIDEO, "video.mp4"),
    (ChangesReport::OUTPUT, "changes.json"),
];

/// Whether all outputs could be written.
pub enum Completeness {
    /// All are in their files.
    All,
    /// The store has lost one of a node.
    Lost(LostOutput),
}

/// An output that the store has lost, or an object that the output refers to.
pub struct LostOutput {
    /// The node.
    pub node: String,
    /// Which output and which object, in a sentence.
    pub what: String,
}

/// Writes new and changed outputs. A file that was written before and not changed since is neither read nor written.
///
/// Verdicts become one file a sol, so that a new sol writes its own.
///
/// # Errors
/// A place that cannot be written, a store that cannot be read, the wish to stop before any file.
pub fn write(session: &Session, record: &RunRecord, out: &Path) -> Result<Completeness, Error> {
    let mut table = ExportTable::load(&session.store, out, record.root);
    let written = write_all(session, record, &mut table);
    table.save();
    match written {
        Err(Fault::Lost(lost)) => Ok(Completeness::Lost(lost)),
        Err(Fault::Other(error)) => Err(error),
        Ok(()) => Ok(Completeness::All),
    }
}

/// Why an output was not written.
enum Fault {
    Lost(LostOutput),
    Other(Error),
}

impl From<Error> for Fault {
    fn from(error: Error) -> Self {
        Self::Other(error)
    }
}

impl From<marf_cache::manifest::ManifestError> for Fault {
    fn from(error: marf_cache::manifest::ManifestError) -> Self {
        Self::Other(error.into())
    }
}

fn write_all(session: &Session, record: &RunRecord, table: &mut ExportTable) -> Result<(), Fault> {
    if let Some(report) = record.documents.get(document::REPORT) {
        let get = || session.store.get(&report.digest).map_err(Error::from);
        table.write(Path::new(document::REPORT), &report.digest, get)?;
    }
    let mut pages = BTreeSet::new();
    for (name, page) in record.documents.iter().filter(|(name, _)| scenes::is_page(name)) {
        let get = || session.store.get(&page.digest).map_err(Error::from);
        table.write(Path::new(name), &page.digest, get)?;
        pages.extend(
            Path::new(name)
                .file_name()
                .and_then(|name| name.to_str())
                .map(str::to_owned),
        );
    }
    if !pages.is_empty() {
        table.keep_only(Path::new(SCENE_PAGES), &pages)?;
    }
    for node in record.nodes.iter().filter(|node| node.parent.is_none()) {
        let folder = Path::new(&node.name);
        let mut written: BTreeMap<PathBuf, BTreeSet<String>> = BTreeMap::new();
        for (name, output) in &node.outputs {
            let get = |digest: &Digest| {
                session.check()?;
                session.store.get(digest).map_err(|error| match error.lost() {
                    Some(_) => Fault::Lost(LostOutput {
                        node: node.name.clone(),
                        what: format!("output `{name}` of `{}`: {error}", node.name),
                    }),
                    None => Fault::Other(error.into()),
                })
            };
            if name == VERDICTS {
                write_verdicts(table, &folder.join(VERDICTS), &output.digest, get)?;
            } else if let Some(file) = file_name(name) {
                let file = folder.join(file);
                table.write(&file, &output.digest, || get(&output.digest))?;
                note(&mut written, &file);
            }
        }
        // Removes maps and frames that the last run had and this one has not. Among new files they would look like its own.
        for (below, names) in written.iter().filter(|(below, _)| *below != folder) {
            table.keep_only(below, names)?;
        }
    }
    Ok(())
}

fn note(written: &mut BTreeMap<PathBuf, BTreeSet<String>>, file: &Path) {
    if let (Some(folder), Some(name)) = (file.parent(), file.file_name().and_then(|name| name.to_str())) {
        written
            .entry(folder.to_owned())
            .or_default()
            .insert(name.to_owned());
    }
}

/// Writes the verdicts of a node, one file a sol, and removes those of sols that are not in the set any more.
fn write_verdicts(
    table: &mut ExportTable,
    folder: &Path,
    root: &Digest,
    mut get: impl FnMut(&Digest) -> Result<std::sync::Arc<[u8]>, Fault>,
) -> Result<(), Fault> {
    if table.has(folder, root) {
        return Ok(());
    }
    let mut names = BTreeSet::new();
    let (mut shard, mut part) = (None, 0);
    for leaf in sets::leaves(root, &mut get)? {
        part = if shard == Some(leaf.shard) { part + 1 } else { 0 };
        shard = Some(leaf.shard);
        let name = match part {
            0 => format!("sol-{:05}.jsonl", leaf.shard),
            part => format!("sol-{:05}-{part}.jsonl", leaf.shard),
        };
        table.write(&folder.join(&name), &leaf.leaf, || get(&leaf.leaf))?;
        names.insert(name);
    }
    table.keep_only(folder, &names)?;
    table.note(folder, root);
    Ok(())
}

/// Writes one object of a run to a file, unless the file is a copy of it already.
///
/// # Errors
/// A place that cannot be written, or an object that the store has lost.
pub fn one(store: &Store, record: &RunRecord, digest: &Digest, path: &Path) -> Result<(), Error> {
    if copies::is_copy(path, digest) {
        return Ok(());
    }
    let bytes = store.get(digest)?;
    files::write(path, &copies::copy(path, digest, &bytes, record.root))
}

/// Writes the report that a run keeps: of the given number, or else of the newest run that keeps one.
///
/// # Errors
/// No such run, a run without a report, a place that cannot be written.
pub fn report(context: &Context, path: &Path, number: Option<u64>) -> Result<(), Error> {
    let store = context.existing_store()?;
    let run = match number {
        Some(number) => marf_engine::run_of(&store, number)?,
        None => {
            let subject = subject(context, &store)?;
            let keeps_one = |run: &RunRecord| run.documents.contains_key(document::REPORT);
            match select::newest_with(&store, &subject, context.warnings(), keeps_one)? {
                Some(run) => run,
                None => newest_run(context, &store)?,
            }
        }
    };
    let report = run.documents.get(document::REPORT).ok_or_else(|| {
        let message = format!("run {} (`{}`) keeps no report", run.number, run.command);
        Error::Failed(Diagnostic::new(message).hint("`marf view` shows the run"))
    })?;
    one(&store, &run, &report.digest, path)
}

/// Returns the file an output becomes. None for manifests, which only the store can resolve, and for names that would lead out of the
/// folder.
pub fn file_name(output: &str) -> Option<&str> {
    if let Some((_, file)) = NAMED.iter().find(|(name, _)| *name == output) {
        return Some(file);
    }
    let path = Path::new(output);
    let plain = path.components().all(|part| matches!(part, Component::Normal(_)));
    (plain && path.extension().is_some()).then_some(output)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outputs_become_files_and_none_leaves_its_folder() {
        assert_eq!(file_name("scene"), Some("scene.json"));
        assert_eq!(file_name("maps/a-std.png"), Some("maps/a-std.png"));
        for bad in ["photos", "companions", "../x.png", "/x.png", "a/../../x.png"] {
            assert_eq!(file_name(bad), None, "{bad}");
        }
    }
}
