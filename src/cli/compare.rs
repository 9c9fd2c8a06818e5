//! `marf compare`: what changed at a place between two times.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use clap::Args;
use marf_cache::Digest;
use marf_engine::{Cancel, NodeRun, RunRecord};
use marf_field::Quality;
use marf_schema::calibrate;
use marf_schema::changes::{Change, ChangesParams, ChangesReport};
use marf_schema::output::CHANGE_MAPS;
use marf_stage::{Document, Params};
use serde_json::{Map, Value, json};

use super::again::{run_nodes, run_where};
use super::args::Global;
use super::error::{CliError, Diagnostic};
use super::export_table::ExportTable;
use super::output::print_json;
use super::session::{Session, digest, existing_store, node_named};
use marf_config::scenes::scene_of;
use crate::terminal::print_line;

/// Most patches that are listed in the terminal.
const MOST_LISTED: usize = 20;
/// The report among the files.
const REPORT: &str = "changes.json";

/// Arguments of `compare`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct CompareArgs {
    /// The scene, where the photos are split by place
    #[arg(value_name = "SCENE")]
    pub scene: Option<String>,
    /// Sols of the earlier and of the later photos: `--sols 1..=2 --sols 8..=9`
    #[arg(long, value_name = "SOLS", required = true)]
    pub sols: Vec<String>,
    /// Folder to write
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Number of the run [default: the last one that has the scene]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
    /// How much time a training may take: `draft`, `standard` or `best`
    #[arg(long, value_name = "QUALITY", default_value = "draft", value_parser = quality)]
    pub quality: Quality,
    /// Optimiser steps of a training, instead of those of its quality
    #[arg(long, value_name = "STEPS")]
    pub steps: Option<u64>,
    /// Trainings of each time, at least 2: how far they differ is the noise
    #[arg(short = 'b', long = "members", value_name = "COUNT", default_value_t = ChangesParams::default().b)]
    pub members: u32,
    /// Width of a cell of the map, metres [default: as fine as the photos allow]
    #[arg(long, value_name = "METRES")]
    pub cell: Option<f64>,
}

const AFTER_HELP: &str = "\
Photos of each time train fields of their own, on the cameras of the run. DIR gets map.png (what changed, over the ground in gray), \
before.png and after.png (orthophotos), height.png (change of height) and height-interval.png (PNG of 16 bits, the scale in their text), a \
world file for each, and changes.json with every patch. Ground that is brighter or darker alone is undecided: a shadow does the same. Nine \
tenths of the ground are taken for unchanged: from them follows how large the noise is.";

fn quality(word: &str) -> Result<Quality, String> {
    serde_json::from_value(json!(word)).map_err(|error| error.to_string())
}

/// Compares what is wanted, unless it is compared already, and writes it.
pub fn compare(global: &Global, args: &CompareArgs, cancel: &Cancel) -> Result<(), CliError> {
    let [before, after] = args.sols.as_slice() else {
        let diagnostic = Diagnostic::new(format!(
            "--sols: {} times are given, two are compared",
            args.sols.len()
        ));
        return Err(CliError::Usage(diagnostic.hint("`--sols 1..=2 --sols 8..=9`")));
    };
    let store = existing_store(global, cancel)?;
    let scene = args.scene.as_deref();
    let has = |run: &RunRecord| calibrated(run, scene).is_some();
    let run = run_where(&store, args.run, has, |run| without(run, scene))?;
    let calibrated = calibrated(&run, scene).ok_or_else(|| without(&run, scene))?;
    let (name, table) = (
        format!("changes-of-{}", calibrated.name),
        table(args, calibrated, before, after)?,
    );
    let (session, record) = run_nodes(store, &run, &[(&name, table)], global, cancel)?;
    let node = node_named(&record, &name)?;
    let report: ChangesReport = session.document(node)?;
    let written = write(&session, &record, node, &args.out)?;
    if global.json {
        return print_json(&json!({"files": written, "run": record.number, "changes": report}));
    }
    text(&report).iter().for_each(|line| print_line(line));
    print_line(&format!(
        "wrote {} files to {}",
        written.len(),
        args.out.display()
    ));
    Ok(())
}

/// Returns the node that placed the photos of a scene; without a scene, of the only one.
fn calibrated<'r>(run: &'r RunRecord, scene: Option<&str>) -> Option<&'r NodeRun> {
    let mut found = placing(run).filter(|node| scene.is_none() || scene_of(&node.name) == scene);
    let first = found.next()?;
    found.next().is_none().then_some(first)
}

/// Returns the nodes of a run that placed photos.
fn placing(run: &RunRecord) -> impl Iterator<Item = &NodeRun> {
    let good = |node: &&NodeRun| node.parent.is_none() && node.state.is_good();
    run.nodes
        .iter()
        .filter(|node| node.stage == calibrate::Metrics::STAGE)
        .filter(good)
}

fn without(run: &RunRecord, scene: Option<&str>) -> CliError {
    let scenes: Vec<&str> = placing(run).filter_map(|node| scene_of(&node.name)).collect();
    let (message, hint) = match (scene, scenes.as_slice()) {
        (Some(scene), []) => (
            format!(
                "run {} does not split its photos by place: there is no scene `{scene}`",
                run.number
            ),
            "leave the scene out".to_owned(),
        ),
        (Some(scene), scenes) => (
            format!("run {} has no scene `{scene}`", run.number),
            format!("its scenes are {}", scenes.join(", ")),
        ),
        (None, []) => (
            format!("run {} has placed no photos, or more than once", run.number),
            "a pipeline with one node `calibrate` is compared".to_owned(),
        ),
        (None, scenes) => (
            format!("run {} has several scenes", run.number),
            format!("name one: {}", scenes.join(", ")),
        ),
    };
    CliError::Usage(Diagnostic::new(message).hint(hint))
}

/// Returns the table of the node, as pipeline.toml would have it.
fn table(args: &CompareArgs, calibrated: &NodeRun, before: &str, after: &str) -> Result<Value, CliError> {
    let edge = calibrated.edges.iter().find(|edge| edge.key == "input");
    let edge = edge.ok_or_else(|| CliError::failed(format!("`{}` read no photos", calibrated.name)))?;
    let photos = match &edge.part {
        Some(part) => format!("{}/{part}", edge.upstream),
        None => edge.upstream.clone(),
    };
    let mut table = Map::from_iter([
        ("uses".to_owned(), json!(ChangesParams::STAGE)),
        ("input".to_owned(), json!(calibrated.name)),
        ("photos".to_owned(), json!(photos)),
        ("before".to_owned(), json!(before)),
        ("after".to_owned(), json!(after)),
        ("quality".to_owned(), json!(args.quality)),
        ("b".to_owned(), json!(args.members)),
    ]);
    table.extend(args.steps.map(|steps| ("steps".to_owned(), json!(steps))));
    table.extend(args.cell.map(|cell| ("cell".to_owned(), json!(cell))));
    Ok(Value::Object(table))
}

fn write(
    session: &Session,
    record: &RunRecord,
    node: &NodeRun,
    out: &Path,
) -> Result<Vec<PathBuf>, CliError> {
    let mut table = ExportTable::load(&session.store, out, record.root);
    let written = write_all(session, &mut table, node);
    table.save();
    Ok(written?.into_iter().map(|file| out.join(file)).collect())
}

fn write_all(
    session: &Session,
    table: &mut ExportTable,
    node: &NodeRun,
) -> Result<BTreeSet<PathBuf>, CliError> {
    let mut files: Vec<(PathBuf, Digest)> =
        vec![(PathBuf::from(REPORT), digest(node, ChangesReport::OUTPUT)?)];
    let maps = node.outputs.iter().filter_map(|(name, output)| {
        let file = name.strip_prefix(CHANGE_MAPS)?;
        Some((PathBuf::from(file), output.digest))
    });
    files.extend(maps);
    for (file, digest) in &files {
        session.check()?;
        table.write(file, digest, || Ok::<_, CliError>(session.store.get(digest)?))?;
    }
    Ok(files.into_iter().map(|(file, _)| file).collect())
}

/// Says what changed.
fn text(report: &ChangesReport) -> Vec<String> {
    let time = |time: &marf_schema::changes::Time| {
        format!(
            "{} photos, {:.1} dB, {:.1} m2",
            time.photos, time.psnr, time.area_m2
        )
    };
    let mut lines = vec![
        format!("before   {}", time(&report.before)),
        format!("after    {}", time(&report.after)),
        format!(
            "compared {:.2} m2 in cells of {:.3} m; where nothing changed 90 % of the heights differ by less than {:.3} m",
            report.compared_m2, report.cell_m, report.height.interval
        ),
        format!(
            "changed  {:.3} m2 in {} patches; undecided {:.3} m2",
            report.changed_m2,
            report
                .patches
                .iter()
                .filter(|patch| patch.change != Change::Undecided)
                .count(),
            report.undecided_m2
        ),
    ];
    for patch in report.patches.iter().take(MOST_LISTED) {
        let word = patch.change.word();
        lines.push(format!(
            "  {word:<14} {:.3} m2 ({:.3} to {:.3}) at {:.2} m right, {:.2} m up; {:+.3} m +- {:.3}, light x {:.2}",
            patch.area_m2,
            patch.area_interval_m2[0],
            patch.area_interval_m2[1],
            patch.middle_m[0],
            patch.middle_m[1],
            patch.height_m[0],
            patch.height_m[1],
            patch.brightness
        ));
    }
    let more = report.patches.len().saturating_sub(MOST_LISTED);
    lines.extend((more > 0).then(|| format!("  and {more} smaller ones in {REPORT}")));
    lines
}
