use std::path::{Path, PathBuf};

use marf_cache::Digest;
use marf_engine::{Cancel, NodeRun};
use marf_scene::Scene;
use serde_json::Value as Json;

use super::args::{CalibrateArgs, Global};
use super::error::{CliError, Diagnostic};
use super::export;
use super::filter::folder;
use super::output::print_json;
use super::run::{execute, options};
use super::session::Session;
use crate::terminal::{escape_control, print_line};

/// Most reasons of photos without a camera that are told one by one.
const MOST_REASONS: usize = 3;

/// `marf calibrate DIR`: writes transforms.json, and beside it metrics.json, COLMAP's model and the points.
pub fn calibrate(global: &Global, args: &CalibrateArgs, cancel: &Cancel) -> Result<(), CliError> {
    let session = Session::implicit(&pipeline(args), global).map_err(for_this_verb)?;
    let (record, ended) = execute(&session, &options(global, &session.name), global, cancel)?;
    ended.map_err(for_this_verb)?;
    let node = record.nodes.iter().find(|node| node.name == "calibrate");
    let node = node.ok_or_else(|| CliError::failed("nothing was calibrated"))?;
    let written = write(&session, node, &args.out)?;
    let bytes = session.store.get(&output(node, "metrics")?)?;
    let metrics: Json =
        serde_json::from_slice(&bytes).map_err(|error| CliError::failed(format!("metrics: {error}")))?;
    if global.json {
        return print_json(&metrics);
    }
    let scene = Scene::decode(&session.store.get(&output(node, "scene")?)?);
    let scene = scene.map_err(|error| CliError::failed(error.to_string()))?;
    print_line(&table(&metrics, &scene, &written));
    Ok(())
}

fn pipeline(args: &CalibrateArgs) -> String {
    format!(
        "name = \"calibrate\"\n{}[node.calibrate]\ninput = \"extract\"\ncameras = \"extract\"\nmethod = \"{}\"\n",
        folder(&args.dir),
        args.method.name()
    )
}

fn output(node: &NodeRun, name: &str) -> Result<Digest, CliError> {
    let output = node.outputs.get(name);
    let output = output.ok_or_else(|| CliError::failed(format!("calibrate gave no `{name}`")))?;
    Ok(output.digest)
}

/// Writes what other programs read, and returns where.
fn write(session: &Session, node: &NodeRun, out: &Path) -> Result<Vec<PathBuf>, CliError> {
    let mut written = vec![out.to_path_buf(), out.with_file_name("metrics.json")];
    export::one(session, &output(node, "transforms")?, &written[0])?;
    export::one(session, &output(node, "metrics")?, &written[1])?;
    for (name, output) in &node.outputs {
        if name.starts_with("sparse/") || name == "points.ply" {
            let path = out.with_file_name("").join(name);
            export::one(session, &output.digest, &path)?;
            written.push(path);
        }
    }
    Ok(written)
}

fn table(metrics: &Json, scene: &Scene, written: &[PathBuf]) -> String {
    let totals = &metrics["totals"];
    let count = |key: &str| totals[key].as_u64().unwrap_or(0);
    let mut rows = vec![
        ("method", scene.method.clone()),
        (
            "registered",
            format!("{} of {} photos", count("registered"), count("photos")),
        ),
    ];
    let mut reasons = reasons(scene);
    let rest: usize = reasons
        .split_off(reasons.len().min(MOST_REASONS))
        .iter()
        .map(|one| one.1)
        .sum();
    rows.extend(
        reasons
            .into_iter()
            .map(|(reason, count)| ("", format!("{count} not: {reason}"))),
    );
    rows.extend((rest > 0).then(|| ("", format!("{rest} not, for other reasons (metrics.json)"))));
    rows.extend(
        totals["components"]
            .as_u64()
            .map(|components| ("components", components.to_string())),
    );
    let error = totals["error_px"].as_f64();
    rows.push((
        "mean error",
        error.map_or("not measured".to_owned(), |error| format!("{error:.3} px")),
    ));
    rows.push(("points", count("points").to_string()));
    let scale = scene
        .metres_per_unit
        .map(|metres| format!("one unit is {metres} m"));
    rows.push(("scale", scale.unwrap_or_else(|| "no scale".to_owned())));
    for (index, path) in written.iter().enumerate() {
        rows.push((if index == 0 { "wrote" } else { "" }, path.display().to_string()));
    }
    let lines = rows
        .iter()
        .map(|(what, value)| format!("{what:<12} {}", escape_control(value)));
    lines.collect::<Vec<_>>().join("\n")
}

/// Why photos have no camera, the commonest reason first.
fn reasons(scene: &Scene) -> Vec<(&str, usize)> {
    let mut counts: std::collections::BTreeMap<&str, usize> = std::collections::BTreeMap::new();
    for one in &scene.unplaced {
        *counts.entry(&one.reason).or_default() += 1;
    }
    let mut counts: Vec<_> = counts.into_iter().collect();
    counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    counts
}

/// Says hints about pipeline.toml as this verb's arguments, as it has no pipeline to edit.
fn for_this_verb(error: CliError) -> CliError {
    let say = |diagnostic: Diagnostic| Diagnostic {
        hint: diagnostic.hint.map(|hint| as_arguments(&hint)),
        ..diagnostic
    };
    match error {
        CliError::Failed(diagnostic) => CliError::Failed(say(diagnostic)),
        CliError::Usage(diagnostic) => CliError::Usage(say(diagnostic)),
        other => other,
    }
}

/// What stands between backquotes and is a key becomes the argument that sets it.
fn as_arguments(hint: &str) -> String {
    let hint = hint.replace("`path` of the archive", "DIR");
    let argument = |(index, part): (usize, &str)| match part.split_once(" = ") {
        _ if index % 2 == 0 => part.to_owned(),
        Some(("method", value)) => format!("--method {}", value.trim_matches('"')),
        Some((key, value)) => format!("--set calibrate.{key}={}", value.trim_matches('"')),
        None if is_key(part) => format!("--set calibrate.{part}=…"),
        None => part.to_owned(),
    };
    hint.split('`')
        .enumerate()
        .map(argument)
        .collect::<Vec<_>>()
        .join("`")
}

fn is_key(word: &str) -> bool {
    let calibrate = marf_stages::stages().iter().find(|def| def.name == "calibrate");
    let schema = calibrate.map(|def| (def.schema)().to_value());
    schema.is_some_and(|schema| schema["properties"].get(word).is_some())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hints_about_keys_are_said_as_arguments() {
        for (hint, said) in [
            (
                "choose one, for example `file = \"a/b.json\"`",
                "choose one, for example `--set calibrate.file=a/b.json`",
            ),
            (
                "set `hold_every = 0`, or name photos in `train_filenames`",
                "set `--set calibrate.hold_every=0`, or name photos in `train_filenames`",
            ),
            ("change `file`", "change `--set calibrate.file=…`"),
            ("use `method = \"sfm\"`", "use `--method sfm`"),
            ("set `path` of the archive to the folder", "set DIR to the folder"),
            ("nothing of ours, `x/y.json`", "nothing of ours, `x/y.json`"),
        ] {
            assert_eq!(as_arguments(hint), said);
        }
    }
}
