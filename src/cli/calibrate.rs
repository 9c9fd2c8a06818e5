use std::path::{Path, PathBuf};

use marf_cache::Digest;
use marf_engine::{Cancel, NodeRun, RunRecord};
use marf_scene::Scene;
use marf_schema::calibrate::{CalibrateParams, Metrics};
use marf_schema::cameras::CamerasParams;
use marf_schema::output;
use marf_stage::{Document, Params};

use super::args::{CalibrateArgs, Global};
use super::copies;
use super::error::{CliError, Diagnostic};
use super::export;
use super::files;
use super::folder;
use super::output::print_json;
use super::run::{execute, options};
use super::session::{Session, digest, node_named};
use super::share::cameras;
use crate::terminal::{escape_control, print_line};

/// Most reasons of photos without a camera that have a line of their own.
const MOST_REASONS: usize = 3;

/// `marf calibrate DIR`: writes transforms.json, and beside it metrics.json, COLMAP's model, the points, and the photos that do not lie where they came from.
pub fn calibrate(global: &Global, args: &CalibrateArgs, cancel: &Cancel) -> Result<(), CliError> {
    let photos_at = files::relative(folder_of(&args.out), &args.dir)?;
    let text = folder::cameras(
        "calibrate",
        &args.dir,
        args.method.name(),
        &photos_at,
        args.undistort,
    );
    let session = Session::implicit(&text, global, cancel).map_err(for_this_verb)?;
    let (record, ended) = execute(&session, &options(global, &session.name), global, cancel)?;
    ended.map_err(for_this_verb)?;
    let node = node_named(&record, CalibrateParams::STAGE)?;
    let cameras = node_named(&record, CamerasParams::STAGE)?;
    let written = write(&session, &record, (node, cameras), args)?;
    let metrics: Metrics = session.document(node)?;
    if global.json {
        return print_json(&serde_json::to_value(metrics).unwrap_or_default());
    }
    let scene = Scene::decode(&session.output(node, output::SCENE)?);
    let scene = scene.map_err(|error| CliError::failed(error.to_string()))?;
    print_line(&table(&metrics, &scene, &written));
    Ok(())
}

/// Returns the folder of a file.
fn folder_of(file: &Path) -> &Path {
    file.parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}

/// Writes what other programs read, and returns where; photos, of which there are many, are written last and not listed.
fn write(
    session: &Session,
    record: &RunRecord,
    (node, cameras): (&NodeRun, &NodeRun),
    args: &CalibrateArgs,
) -> Result<Vec<PathBuf>, CliError> {
    let mut written = vec![args.out.clone(), args.out.with_file_name("metrics.json")];
    let all = cameras::files_of(cameras);
    let (models, photos) = all.split_at(cameras::model_count(&all));
    for (name, digest) in models {
        let path = match *name {
            cameras::TRANSFORMS => args.out.clone(),
            name => args.out.with_file_name("").join(name),
        };
        export::one(session, record, digest, &path)?;
        written.extend((*name != cameras::TRANSFORMS).then_some(path));
    }
    export::one(session, record, &digest(node, Metrics::OUTPUT)?, &written[1])?;
    for (name, digest) in photos {
        let path = args.out.with_file_name("").join(name);
        refuse_to_replace(&path, digest, &args.dir)?;
        export::one(session, record, digest, &path)?;
    }
    Ok(written)
}

/// Refuses to write over one of the photos that were read.
fn refuse_to_replace(path: &Path, digest: &Digest, dir: &Path) -> Result<(), CliError> {
    let (Ok(file), Ok(dir)) = (path.canonicalize(), dir.canonicalize()) else {
        return Ok(()); // There is no such file.
    };
    if !file.starts_with(dir) || copies::is_copy(path, digest) {
        return Ok(());
    }
    let message = format!(
        "{} is one of the photos, and another picture is to be written there",
        path.display()
    );
    Err(CliError::Usage(
        Diagnostic::new(message).hint("name a file in another folder with --out"),
    ))
}

fn table(metrics: &Metrics, scene: &Scene, written: &[PathBuf]) -> String {
    let totals = &metrics.totals;
    let mut rows = vec![
        ("method", scene.method.clone()),
        (
            "registered",
            format!("{} of {} photos", totals.registered, totals.photos),
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
        totals
            .components
            .map(|components| ("components", components.to_string())),
    );
    rows.push((
        "mean error",
        totals
            .error_px
            .map_or("not measured".to_owned(), |error| format!("{error:.3} px")),
    ));
    rows.push(("points", totals.points.to_string()));
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

/// Rewrites hints about pipeline.toml as arguments: this verb has no pipeline to edit.
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
    let calibrate = marf_stages::stages()
        .iter()
        .find(|def| def.name == CalibrateParams::STAGE);
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
