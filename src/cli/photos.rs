use std::path::PathBuf;

use clap::Args;
use marf_run::photos::{PhotoLine, PhotosRequest, UnreadFile};
use marf_run::{Context, Error};
use marf_scene::CameraPrior;

use super::global::Global;
use super::output::print_json;
use crate::terminal::print_line;

/// Arguments of `photos`.
#[derive(Debug, Clone, Args)]
pub struct PhotosArgs {
    /// A folder with photos [default: the last run of the pipeline]
    dir: Option<PathBuf>,
    /// The node whose photos are shown
    #[arg(long, default_value = "extract")]
    node: String,
}

/// `marf photos [DIR]`: what was read of every photo, from a folder or from the pipeline's last run, and which files were not.
pub fn photos(global: &Global, args: PhotosArgs, context: &Context) -> Result<(), Error> {
    let request = PhotosRequest {
        dir: args.dir,
        node: args.node,
    };
    let table = marf_run::photos::photos(context, &request)?;
    if global.json {
        return print_json(&table);
    }
    print_line(
        "| product | format | pixels | camera of the label | frame | site, drive, pose | sol | notes |",
    );
    print_line("|---|---|---|---|---|---|---|---|");
    table.photos.iter().for_each(|line| print_line(&row(line)));
    if !table.not_read.is_empty() {
        print_line("\n| file without a photo | why |\n|---|---|");
        for UnreadFile { file, reason } in &table.not_read {
            print_line(&cells(&[file.clone(), reason.clone()]));
        }
    }
    Ok(())
}

/// Returns a row of a table.
fn cells(cells: &[String]) -> String {
    let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
    format!("| {} |", cells.join(" | "))
}

fn row(line: &PhotoLine) -> String {
    let facts = &line.facts;
    let prior = facts.prior.as_ref();
    let known = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
    cells(&[
        line.product.clone(),
        line.format.to_owned(),
        format!("{} x {} x {}", facts.width, facts.height, facts.bands),
        known(
            prior
                .map(camera)
                .or_else(|| facts.focal_px.map(|focal| format!("EXIF {focal:.1} px"))),
        ),
        known(prior.map(frame)),
        known(prior.and_then(place)),
        known(facts.sol.map(|sol| sol.to_string())),
        facts.notes.join("; "),
    ])
}

/// Model, focal length and principal point, pixels.
fn camera(prior: &CameraPrior) -> String {
    let kind = match (prior.model.o, prior.model.e) {
        (_, Some(_)) => "CAHVORE",
        (Some(_), None) => "CAHVOR",
        _ => "CAHV",
    };
    match prior.model.intrinsics() {
        Ok(k) => format!("{kind} {:.1} px at ({:.0}, {:.0})", k.hs, k.hc, k.vc),
        Err(error) => format!("{kind}: {error}"),
    }
}

fn frame(prior: &CameraPrior) -> String {
    match prior.site_from_frame {
        Some(_) => prior.frame.clone(),
        None => format!("{}, not placed in a site", prior.frame),
    }
}

/// The first three numbers of the rover's motion counter.
fn place(prior: &CameraPrior) -> Option<String> {
    let numbers: Vec<String> = prior.motion_counter.iter().take(3).map(i64::to_string).collect();
    (!numbers.is_empty()).then(|| numbers.join(", "))
}
