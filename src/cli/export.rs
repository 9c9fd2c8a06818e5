//! Writes the outputs of a run to `OUT/<node>/<file>`.

use std::path::{Component, Path};

use marf_cache::Digest;
use marf_engine::RunRecord;
use marf_schema::{output, train, tune};
use marf_stage::{Document, VERDICTS};

use super::error::CliError;
use super::files;
use super::session::Session;

/// Outputs without a file name of their own, and the name they get.
const NAMED: [(&str, &str); 10] = [
    (output::SCENE, "scene.json"),
    (output::TRANSFORMS, "transforms.json"),
    (train::Metrics::OUTPUT, "metrics.json"),
    (output::WEIGHTS, "weights.safetensors"),
    (train::Curve::OUTPUT, "curve.json"),
    (tune::BestParams::OUTPUT, "params.json"),
    (tune::Trials::OUTPUT, "trials.json"),
    (tune::Scatter::OUTPUT, "scatter.json"),
    (VERDICTS, "verdicts.jsonl"),
    (output::VIDEO, "video.gif"),
];

/// Writes what is new or different; a file that already holds the same bytes is left alone.
///
/// # Errors
/// A place that cannot be written, or an output that the store has lost.
pub fn outputs(session: &Session, record: &RunRecord, out: &Path) -> Result<(), CliError> {
    for node in record.nodes.iter().filter(|node| node.parent.is_none()) {
        for (name, output) in &node.outputs {
            if let Some(file) = file_name(name) {
                one(session, &output.digest, &out.join(&node.name).join(file))?;
            }
        }
    }
    Ok(())
}

/// Writes one output to a file, unless it is there already.
///
/// # Errors
/// As [`outputs`].
pub fn one(session: &Session, digest: &Digest, path: &Path) -> Result<(), CliError> {
    if std::fs::read(path).is_ok_and(|bytes| Digest::of(&bytes) == *digest) {
        return Ok(());
    }
    files::write(path, &session.store.get(digest)?)
}

/// Returns the file an output becomes; `None` for manifests, which only the store can resolve.
/// A name that would lead out of its folder has none.
fn file_name(output: &str) -> Option<&str> {
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
