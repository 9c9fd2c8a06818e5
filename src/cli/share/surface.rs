//! `marf export mesh | points | splats | height | orthophoto | depth`: files of a trained field for other programs.

use std::path::{Path, PathBuf};

use clap::Args;
use marf_cache::Store;
use marf_engine::{Cancel, NodeRun, RunRecord};
use marf_schema::output::{DEPTH, MESH_GLB, MESH_PLY, POINTS, SPLAT_VIEWS, SPLATS, SURFACE_MAPS};
use marf_schema::surface::{ColorBy, SplatPsnr, SplatReport, SpreadOf, SurfaceParams, SurfaceReport};
use marf_stage::Params;
use serde_json::{Map, Value, json};

use super::super::again::{run_nodes, run_where, run_with, without};
use super::super::args::Global;
use super::super::error::{CliError, Diagnostic};
use super::super::export::one;
use super::super::field_file::made_by;
use super::super::output::print_json;
use super::super::session::{bootstraps_of, digest, existing_store, node_named};
use crate::terminal::print_line;

/// Arguments of the exports of a surface.
#[derive(Debug, Clone, Args)]
pub struct SurfaceArgs {
    /// A node with a trained field
    #[arg(value_name = "NODE", default_value = "train")]
    pub node: String,
    /// The field in this file instead, as a run of the store made it (`out/train/weights.safetensors`)
    #[arg(long, value_name = "FILE", conflicts_with = "node")]
    pub field: Option<PathBuf>,
    /// Where to
    #[arg(long, value_name = "PATH")]
    pub out: PathBuf,
    /// Number of the run [default: the last one that has the node]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
    /// Distance between samples, metres (units of the scene where it has no scale) [default: two pixels of what is near]
    #[arg(long, value_name = "LENGTH")]
    pub cell: Option<f64>,
    /// Largest distance from a photo, as `--cell` [default: where a pixel is four cells wide]
    #[arg(long, value_name = "LENGTH")]
    pub reach: Option<f64>,
    /// Photos that must show a point [default: 2; of splats 1]
    #[arg(long, value_name = "COUNT")]
    pub least_photos: Option<u32>,
    /// Largest difference between the views at a point, as `--cell` [default: a cell]
    #[arg(long, value_name = "LENGTH")]
    pub most_spread: Option<f64>,
    /// What mesh and points are coloured by: `photos`, or `uncertainty`: how far the retrainings of the run's bootstrap differ, or the views
    /// of the field where the run has none
    #[arg(long, value_name = "WHAT", default_value = "photos", value_parser = color)]
    pub color: ColorBy,
    /// Width of a pixel of a map, metres [default: that of a cell]
    #[arg(long, value_name = "METRES")]
    pub map_cell: Option<f64>,
}

/// Arguments of `export splats`.
#[derive(Debug, Clone, Args)]
pub struct SplatsArgs {
    #[command(flatten)]
    pub surface: SurfaceArgs,
    /// Folder for pictures splats | field at the views of the held-out photos
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
}

/// Reads what colours are, as pipeline.toml has it.
fn color(word: &str) -> Result<ColorBy, String> {
    serde_json::from_value(json!(word)).map_err(|error| error.to_string())
}

/// What is exported.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A mesh, by the ending of the file.
    Mesh,
    /// A cloud of points.
    Points,
    /// Gaussian splats.
    Splats,
    /// Heights, and how far views differ.
    Height,
    /// Colours from above.
    Orthophoto,
    /// Depths at the views of all photos.
    Depth,
}

/// Makes splats and writes them, with pictures if they are asked for.
pub fn export_splats(global: &Global, args: &SplatsArgs, cancel: &Cancel) -> Result<(), CliError> {
    if args.surface.color != ColorBy::default() {
        return Err(CliError::usage(
            "splats show the colours of the photos; `export mesh` and `export points` show uncertainty"
                .to_owned(),
        ));
    }
    make(
        global,
        Kind::Splats,
        &args.surface,
        args.pictures.as_deref(),
        cancel,
    )
}

/// Makes what is wanted, unless it is made already, and writes it.
pub fn export(global: &Global, kind: Kind, args: &SurfaceArgs, cancel: &Cancel) -> Result<(), CliError> {
    make(global, kind, args, None, cancel)
}

fn make(
    global: &Global,
    kind: Kind,
    args: &SurfaceArgs,
    pictures: Option<&Path>,
    cancel: &Cancel,
) -> Result<(), CliError> {
    check_ending(kind, &args.out)?;
    let store = existing_store(global, cancel)?;
    let (trained, run) = trained(&store, args)?;
    let name = format!("surface-of-{trained}");
    let table = table(kind, args, &run, &trained);
    let (session, record) = run_nodes(store, &run, &[(&name, table)], global, cancel)?;
    let node = node_named(&record, &name)?;
    let report: SurfaceReport = session.document(node)?;
    if let (Kind::Height | Kind::Orthophoto, Some(why)) = (kind, report.refused.get(SURFACE_MAPS)) {
        // Of a scene without scale all else is asked for in vain.
        let hint = match (report.vertices, report.unit.as_str()) {
            (0, "metres") => {
                "lower --least-photos, or widen --most-spread or --cell: what few photos show alike is left out"
            }
            _ => {
                "cameras from labels (`method = \"sfm\"` or \"labels\" on photos with labels) give metres and an up direction"
            }
        };
        return Err(CliError::Failed(Diagnostic::new(why.clone()).hint(hint)));
    }
    let mut files = files_of(kind, node, &args.out);
    files.extend(
        pictures
            .map(|folder| below(node, SPLAT_VIEWS, folder))
            .unwrap_or_default(),
    );
    for (name, path) in &files {
        one(&session, &record, &digest(node, name)?, path)?;
    }
    let written: Vec<PathBuf> = files.into_iter().map(|(_, path)| path).collect();
    if global.json {
        return print_json(&json!({"files": written, "run": record.number, "surface": report}));
    }
    print_line(&text(kind, &report));
    if matches!(kind, Kind::Mesh | Kind::Points) {
        print_line(&uncertainty_text(&report));
    }
    for path in written {
        print_line(&format!("wrote {}", path.display()));
    }
    Ok(())
}

/// Returns the node whose field is exported, and a run that has it.
fn trained(store: &Store, args: &SurfaceArgs) -> Result<(String, RunRecord), CliError> {
    let Some(file) = &args.field else {
        return Ok((args.node.clone(), run_with(store, args.run, &args.node)?));
    };
    let (node, runs) = made_by(store, file, args.run)?;
    // A run that has retrained it tells more than one that reused it.
    let has = |run: &RunRecord| runs.contains(&run.number);
    let retrained = |run: &RunRecord| has(run) && bootstraps_of(run, &node).any(|node| node.state.is_good());
    let missing = |run: &RunRecord| without(run, &node);
    let run = run_where(store, args.run, retrained, missing)
        .or_else(|_| run_where(store, args.run, has, missing))?;
    Ok((node, run))
}

/// Refuses an ending that says something else than what is written.
fn check_ending(kind: Kind, out: &Path) -> Result<(), CliError> {
    let endings: &[&str] = match kind {
        Kind::Mesh => &["ply", "glb"],
        Kind::Points | Kind::Splats => &["ply"],
        Kind::Height | Kind::Orthophoto => &["png", "tif"],
        Kind::Depth => return Ok(()),
    };
    let ending = out
        .extension()
        .and_then(|ending| ending.to_str())
        .unwrap_or_default();
    match endings.contains(&ending) {
        true => Ok(()),
        false => Err(CliError::usage(format!(
            "--out {}: the file must end with .{}",
            out.display(),
            endings.join(" or .")
        ))),
    }
}

/// Returns the table of the node, as pipeline.toml would have it.
fn table(kind: Kind, args: &SurfaceArgs, run: &RunRecord, trained: &str) -> Value {
    let mut table = Map::from_iter([
        ("uses".to_owned(), json!(SurfaceParams::STAGE)),
        ("input".to_owned(), json!(trained)),
    ]);
    let lengths = [
        ("cell", args.cell),
        ("reach", args.reach),
        ("most_spread", args.most_spread),
        ("map_cell", args.map_cell),
    ];
    let lengths = lengths
        .into_iter()
        .filter_map(|(key, length)| Some((key, json!(length?))));
    // Splats are looked at, not measured: what one photo shows is worth showing.
    let least_photos = args.least_photos.or((kind == Kind::Splats).then_some(1));
    let count = least_photos.map(|count| ("least_photos", json!(count)));
    let has_members = matches!(kind, Kind::Mesh | Kind::Points);
    let members = bootstraps_of(run, trained).find(|node| has_members && node.state.is_good());
    let members = members.map(|node| ("members", json!(node.name)));
    let color = (args.color != ColorBy::default()).then_some(("color", json!(args.color)));
    let depth = (kind == Kind::Depth).then_some(("depth", json!(true)));
    let splats = (kind == Kind::Splats).then_some(("splats", json!(true)));
    table.extend(
        lengths
            .chain(count)
            .chain(depth)
            .chain(splats)
            .chain(members)
            .chain(color)
            .map(|(key, value)| (key.to_owned(), value)),
    );
    Value::Object(table)
}

/// Returns the outputs to write, and where to.
fn files_of(kind: Kind, node: &NodeRun, out: &Path) -> Vec<(String, PathBuf)> {
    let is_glb = out.extension().is_some_and(|ending| ending == "glb");
    let is_tiff = out.extension().is_some_and(|ending| ending == "tif");
    let map = |name: &str, ending: &str| format!("{SURFACE_MAPS}{name}.{ending}");
    match kind {
        Kind::Mesh if is_glb => vec![(MESH_GLB.to_owned(), out.to_owned())],
        Kind::Mesh => vec![(MESH_PLY.to_owned(), out.to_owned())],
        Kind::Points => vec![(POINTS.to_owned(), out.to_owned())],
        Kind::Splats => vec![(SPLATS.to_owned(), out.to_owned())],
        Kind::Height if is_tiff => vec![
            (map("height", "tif"), out.to_owned()),
            (map("spread", "tif"), beside(out, "-spread")),
        ],
        Kind::Height => {
            let spread = beside(out, "-spread");
            vec![
                (map("height", "png"), out.to_owned()),
                (map("height", "pgw"), out.with_extension("pgw")),
                (map("spread", "pgw"), spread.with_extension("pgw")),
                (map("spread", "png"), spread),
            ]
        }
        Kind::Orthophoto if is_tiff => vec![(map("orthophoto", "tif"), out.to_owned())],
        Kind::Orthophoto => vec![
            (map("orthophoto", "png"), out.to_owned()),
            (map("orthophoto", "pgw"), out.with_extension("pgw")),
        ],
        Kind::Depth => below(node, DEPTH, out),
    }
}

/// Returns the outputs of a node whose names begin with a prefix, and their files in a folder.
fn below(node: &NodeRun, prefix: &str, folder: &Path) -> Vec<(String, PathBuf)> {
    let names = node.outputs.keys();
    let files = names.filter_map(|name| Some((name.clone(), folder.join(name.strip_prefix(prefix)?))));
    files.collect()
}

/// Returns the file beside another whose name has more before the ending.
fn beside(file: &Path, more: &str) -> PathBuf {
    let [stem, ending] =
        [file.file_stem(), file.extension()].map(|part| part.unwrap_or_default().to_string_lossy());
    file.with_file_name(format!("{stem}{more}.{ending}"))
}

/// Says what the uncertainty of a surface is.
fn uncertainty_text(report: &SurfaceReport) -> String {
    let uncertainty = &report.uncertainty;
    let of = match uncertainty.of {
        SpreadOf::Retrainings => format!("{} retrainings differ by", uncertainty.members),
        SpreadOf::Views => "no bootstrap: the views of the field differ by".to_owned(),
    };
    format!(
        "{of} {:.4} at half of the vertices, {:.4} at 95 of 100 ({})",
        uncertainty.median, uncertainty.scale_end, report.unit
    )
}

fn text(kind: Kind, report: &SurfaceReport) -> String {
    let SurfaceReport {
        photos, cell, unit, ..
    } = report;
    if let (Kind::Splats, Some(splats)) = (kind, &report.splats) {
        return splats_text(splats, report);
    }
    match (kind, &report.map) {
        (Kind::Points, _) => format!(
            "{} points in cells of {cell:.4} ({unit}), from {photos} photos",
            report.points
        ),
        (Kind::Height | Kind::Orthophoto, Some(map)) => format!(
            "{} x {} pixels of {:.4} m, {:.0} % with a surface; heights from {:.3} m in steps of {} m",
            map.columns,
            map.rows,
            map.pixel_m,
            100.0 * map.covered_share,
            map.lowest_m,
            map.interval_m
        ),
        (Kind::Depth, _) => format!("depths at the views of {photos} photos ({unit})"),
        _ => format!(
            "{} triangles, {} vertices, samples {cell:.4} apart ({unit}), from {photos} photos",
            report.triangles, report.vertices
        ),
    }
}

/// Says how many splats there are, and how near they come to the field.
fn splats_text(splats: &SplatReport, report: &SurfaceReport) -> String {
    let mut text = format!(
        "{} splats, standard deviations {:.4} to {:.4} ({}), from {} photos; {} before the surface left out; no sky, no colours by direction",
        splats.splats, splats.finest, splats.coarsest, report.unit, report.photos, splats.floating
    );
    for (of, psnr) in [
        ("trained on", splats.trained_on),
        ("held out", splats.held_out),
        (
            "held out, but for what no photo trained on saw",
            splats.held_out_seen,
        ),
    ] {
        text += &match psnr {
            Some(SplatPsnr {
                photos,
                mean_db,
                least_db,
                share,
            }) => format!(
                "\nagainst the field at {photos} photos {of}: PSNR {mean_db:.2} dB, {least_db:.2} the worst, over the {:.0} % of the pixels where it shows a surface",
                100.0 * share
            ),
            None => format!("\nagainst the field at photos {of}: nothing to compare"),
        };
    }
    text
}
